/** Server-Sent Events over `fetch`: an EventSource could not send the key. */

import { call } from "./api.js";

/** The service says something every 15 s at least: a connection that is silent for longer is dead. */
const SILENCE_MS = 40_000;

/**
 * The `data` of each event at `path`, as JSON, until the stream ends. Throws what `call` throws, and when the
 * connection breaks, or is silent for too long.
 */
export async function* events(path) {
  const connection = new AbortController();
  let timer = 0;
  const heard = () => {
    clearTimeout(timer);
    timer = setTimeout(() => connection.abort(), SILENCE_MS);
  };
  try {
    heard();
    const answer = await call(path, { signal: connection.signal, again: false, headers: { Accept: "text/event-stream" } });
    if (answer.status === 204) return;
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let text = "";
    for (;;) {
      heard();
      const { value, done } = await reader.read();
      if (done) return;
      text += value;
      const blocks = text.split("\n\n");
      text = blocks.pop();
      for (const block of blocks) {
        const data = block.split("\n").filter((line) => line.startsWith("data:")).map((line) => line.slice(5).trimStart());
        if (data.length) yield JSON.parse(data.join("\n"));
      }
    }
  } finally {
    clearTimeout(timer);
    connection.abort(); // whoever stops listening leaves no connection
  }
}
