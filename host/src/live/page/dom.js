/**
 * Small helpers for elements and canvases.
 */

/** @returns {HTMLElement} the element with this id */
export const byId = (id) => document.getElementById(id);

/** A new element: `make("p", "note", "text", child, …)`. */
export function make(tag, className, ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.append(...children);
  return element;
}

/** A new button that does this. */
export function button(text, act) {
  const element = make("button", "", text);
  element.type = "button";
  element.addEventListener("click", act);
  return element;
}

/** Writes text only if it differs: an equal text would cost a layout. */
export function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export function show(element, isShown) {
  if (element.hidden === isShown) element.hidden = !isShown;
}

/** Whether typing goes to this element, so that keys of the page must not. */
export const takesKeys = (element) => Boolean(element?.closest?.("input, select, textarea, dialog"));

/** A canvas as sharp as the screen that follows the size of its element; drawing is in CSS pixels. */
export class Surface {
  /** @param {HTMLCanvasElement} canvas @param {() => void} changed called after a change of size */
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.width = this.height = 0;
    new ResizeObserver(() => {
      this.#fit();
      changed();
    }).observe(canvas);
    // What is far out of sight is not drawn.
    this.isSeen = true;
    const watch = (entries) => {
      this.isSeen = entries.at(-1).isIntersecting;
      if (this.isSeen) changed();
    };
    new IntersectionObserver(watch, { rootMargin: "100% 0px" }).observe(canvas);
    this.#fit();
  }

  #fit() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    if (clientWidth === this.width && clientHeight === this.height && ratio === this.ratio) return;
    [this.width, this.height, this.ratio] = [clientWidth, clientHeight, ratio];
    this.canvas.width = Math.max(Math.round(clientWidth * ratio), 1);
    this.canvas.height = Math.max(Math.round(clientHeight * ratio), 1);
  }

  /** An empty canvas to draw on; null while it has no size, or is far out of sight. */
  start() {
    if (!this.width || !this.height || !this.isSeen) return null;
    this.context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    this.context.clearRect(0, 0, this.width, this.height);
    return this.context;
  }
}

/** Keeps a value for this tab, over reloads; without storage a reload forgets it. */
export function remember(key, value) {
  try {
    sessionStorage.setItem(`slitpose-${key}`, JSON.stringify(value));
  } catch {
    // Nothing depends on it.
  }
}

export function remembered(key) {
  try {
    return JSON.parse(sessionStorage.getItem(`slitpose-${key}`));
  } catch {
    return null;
  }
}
