// Uploads a file by tus-js-client as an application would: node upload.mjs ENDPOINT FILE METADATA(JSON) CHUNK [BREAK_AT]
// With BREAK_AT the first client is aborted after so many bytes, and a second one resumes from what the server has.
// Prints the last answer's media as JSON.
import { createReadStream, statSync } from 'node:fs'
import { createRequire } from 'node:module'

const tus = createRequire(process.env.TUS_JS_CLIENT + '/')('tus-js-client')
const [endpoint, file, metadata, chunk, breakAt] = process.argv.slice(2)
const uploadSize = statSync(file).size
let media = null

function upload(uploadUrl, stopAt) {
  return new Promise((resolve, reject) => {
    const one = new tus.Upload(createReadStream(file), {
      endpoint,
      uploadUrl,
      uploadSize,
      chunkSize: Number(chunk),
      retryDelays: null,
      metadata: JSON.parse(metadata),
      headers: process.env.KEY ? { Authorization: `Bearer ${process.env.KEY}` } : {},
      onAfterResponse: (_, response) => { media = response.getHeader('Pvg-Media') ?? media },
      onChunkComplete: (_, accepted) => {
        if (stopAt && accepted >= stopAt) one.abort().then(() => resolve(one.url))
      },
      onError: reject,
      onSuccess: () => resolve(one.url),
    })
    one.start()
  })
}

let url = await upload(undefined, breakAt ? Number(breakAt) : 0)
if (breakAt) url = await upload(url, 0)
console.log(JSON.stringify({ url, media }))
