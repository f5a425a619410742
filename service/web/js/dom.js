/** Small helpers to build and mend parts of the page. Nothing here takes HTML as text. */

/** An element with attributes and children; `on…` are listeners, `true` is an attribute without a value. */
export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === undefined || value === null || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "class") made.className = value;
    else if (name === "value") made.value = value;
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return made;
}

const SVG = "http://www.w3.org/2000/svg";

/** One of the symbols of index.html; it says nothing to a screen reader. */
export function icon(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS(SVG, "use");
  use.setAttribute("href", `#i-${name}`);
  svg.append(use);
  return svg;
}

/** A button of an icon alone, with its name for those who do not see it. */
export function iconButton(name, label, onclick, attributes = {}) {
  return el("button", { type: "button", class: "icon", "aria-label": label, title: label, onclick, ...attributes }, icon(name));
}

/** Set the text of an element if it differs, so that nothing is read out again. */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/**
 * Make a list's children those of `items`, keeping the element of each key, and with it focus and selection. The focus
 * of one that goes is its neighbour's.
 * `create(item)` makes an element with the function `update(item)` as its property.
 */
export function keyed(list, items, keyOf, create) {
  const before = new Map([...list.children].map((child) => [child.dataset.key, child]));
  const wanted = new Set(items.map((item) => String(keyOf(item))));
  let place = list.firstElementChild;
  for (const item of items) {
    const key = String(keyOf(item));
    // those that go are passed over: one that is moved loses its focus
    while (place && !wanted.has(place.dataset.key)) place = place.nextElementSibling;
    let child = before.get(key);
    before.delete(key);
    if (!child) {
      child = create(item);
      child.dataset.key = key;
    }
    if (child === place) place = place.nextElementSibling;
    else list.insertBefore(child, place);
    child.update?.(item);
  }
  for (const child of before.values()) {
    const next = child.contains(document.activeElement) ? child.nextElementSibling ?? child.previousElementSibling : null;
    child.remove();
    next?.querySelector("button, input, summary")?.focus();
  }
}

/**
 * Take files that are dropped on an element; it has the class `over` while some are above it. `missed` is called when
 * something else was dropped, such as text.
 */
export function takesFiles(element, take, missed) {
  let depth = 0;
  const has = (event) => [...(event.dataTransfer?.types ?? [])].includes("Files");
  element.addEventListener("dragenter", (event) => {
    if (!has(event)) return;
    depth += 1;
    element.classList.add("over");
  });
  element.addEventListener("dragleave", () => {
    depth = Math.max(0, depth - 1);
    if (!depth) element.classList.remove("over");
  });
  element.addEventListener("dragover", (event) => {
    if (has(event)) event.preventDefault();
  });
  element.addEventListener("drop", (event) => {
    depth = 0;
    element.classList.remove("over");
    event.preventDefault();
    // a folder looks like a file that cannot be read
    const items = [...(event.dataTransfer?.items ?? [])].filter((one) => one.kind === "file");
    const isFolder = items.map((one) => one.webkitGetAsEntry?.()?.isDirectory ?? false);
    const files = [...(event.dataTransfer?.files ?? [])].filter((_, index) => !isFolder[index]);
    if (files.length) take(files);
    else missed();
  });
}

/** A button that opens the file chooser. The input itself takes no focus: the button is its name and its place. */
export function fileButton(label, { accept, multiple = false, take, className = "", symbol = null }) {
  const input = el("input", { type: "file", accept, multiple, hidden: true, tabindex: "-1", "aria-label": label });
  input.addEventListener("change", () => {
    const files = [...input.files];
    input.value = "";
    if (files.length) take(files);
  });
  const button = el("button", { type: "button", class: className, onclick: () => input.click() }, symbol && icon(symbol), label);
  return [button, input];
}

let groups = 0;

/**
 * A row of choices of which one holds: `options` are [value, label]. Gives the fieldset; its property `value` reads and
 * sets the choice without telling `take`.
 */
export function choice(label, options, take, { hidden = true } = {}) {
  groups += 1;
  const name = `choice-${groups}`;
  const inputs = options.map(([value, text]) => {
    const input = el("input", { type: "radio", name, onchange: () => take(value) });
    input.value = value;
    return [input, el("label", { class: "chip", title: text }, input, el("span", {}, text))];
  });
  const group = el("fieldset", { class: "chips" }, el("legend", { class: hidden ? "unseen" : "" }, label), ...inputs.map(([, chip]) => chip));
  Object.defineProperty(group, "value", {
    get: () => inputs.find(([input]) => input.checked)?.[0].value ?? null,
    set: (value) => inputs.forEach(([input]) => { input.checked = input.value === String(value); }),
  });
  return group;
}

/** image → the picture that it was to show last */
const due = new WeakMap();

/** Show a picture once it is decoded, so that nothing flickers; unless the image was given another one meanwhile. */
export async function showPicture(image, url) {
  due.set(image, url);
  if (image.src === url) return;
  const next = new Image();
  next.src = url;
  await next.decode().catch(() => undefined);
  if (due.get(image) === url) image.src = url;
}
