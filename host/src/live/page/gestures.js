/**
 * Mouse, touch and keys on the 3-D view: they move the camera, or the tool where it may be dragged.
 */

const STEP = { orbit: 0.08, pan_px: 24, zoom: 1.15 };
const VIEWS = ["iso", "top", "front", "side"];
/** Half the width of the ring that turns the tool: wide enough for a finger. */
const RING_PX = 16;

/**
 * @param {HTMLCanvasElement} canvas
 * @param {import("./view3d.js").View3d} view
 * @param {() => void} changed the camera has moved
 * @param {{move: (metres: number[]) => void, turn: (rotation: number[]) => void, pose: object} | null} tool
 *   that can be dragged
 */
export function attachGestures(canvas, view, changed, tool) {
  const { camera } = view;
  /** Pointers that are down: place by id. */
  const down = new Map();
  let task = "orbit";

  const taskAt = ([x, y], event) => {
    if (view.ring) {
      const [cx, cy, radius] = view.ring;
      const distance = Math.hypot(x - cx, y - cy);
      if (Math.abs(distance - radius) < RING_PX || (distance < radius && event.shiftKey)) return "turn";
      if (distance < radius) return "move";
    }
    return event.button === 0 && !event.shiftKey ? "orbit" : "pan";
  };

  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, place(event));
    task = down.size > 1 ? "pinch" : taskAt(place(event), event);
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const now = place(event);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (task === "pinch" && down.size === 2) {
      const other = [...down].find(([id]) => id !== event.pointerId)[1];
      camera.zoom(distance(now, other) / Math.max(distance(before, other), 1));
      camera.pan(dx / 2, dy / 2);
    } else if (task === "orbit") camera.orbit(-dx * 0.008, dy * 0.008);
    else if (task === "pan") camera.pan(dx, dy);
    else if (task === "move") tool.move(camera.inView(dx, dy, tool.pose.t_m));
    else if (task === "turn") tool.turn(camera.inBall(dx, dy));
    down.set(event.pointerId, now);
    changed();
  });

  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
    canvas.addEventListener(kind, (event) => {
      down.delete(event.pointerId);
      // The finger that stays after a pinch must not make the view jump.
      if (down.size > 0) task = "none";
    });
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("dblclick", () => home("iso"));
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      camera.zoom(Math.exp(-Math.min(Math.max(event.deltaY, -120), 120) * 0.0015));
      changed();
    },
    { passive: false },
  );

  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (arrow && event.shiftKey) camera.pan(arrow[0] * STEP.pan_px, arrow[1] * STEP.pan_px);
    else if (arrow) camera.orbit(arrow[0] * STEP.orbit, -arrow[1] * STEP.orbit);
    else if (event.key === "+" || event.key === "=") camera.zoom(STEP.zoom);
    else if (event.key === "-") camera.zoom(1 / STEP.zoom);
    else if (event.key === "Home") camera.home("iso");
    else return;
    event.preventDefault();
    changed();
  });

  for (const button of document.querySelectorAll("[data-view]")) {
    button.addEventListener("click", () => home(button.dataset.view));
  }

  function home(name) {
    camera.home(name);
    changed();
  }
  /** The home view of a key 1 to 4; whether there is one. */
  return (key) => {
    const name = VIEWS[Number(key) - 1];
    if (name) home(name);
    return Boolean(name);
  };
}

const place = (event) => [event.offsetX, event.offsetY];
const distance = (a, b) => Math.hypot(a[0] - b[0], a[1] - b[1]);
