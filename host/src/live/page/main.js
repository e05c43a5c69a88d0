/**
 * The live page of slitpose: takes messages, keeps what was last said of every board, and draws it.
 *
 * One animation frame draws all that has changed since the last one; while nothing changes, none is asked for. New poses are
 * drawn in space as they come, thirty times a second, and numbers, curves and detectors ten times, as people cannot read them
 * faster: most of a page's work is filling canvases.
 */
import { Banner } from "./banner.js";
import { Daemon, Recorder } from "./daemon.js";
import { byId, make, remember, remembered, show, takesKeys, write } from "./dom.js";
import { Findings } from "./findings.js";
import { CELL_STATES } from "./format.js";
import { attachGestures } from "./gestures.js";
import { Guide } from "./guide.js";
import { History } from "./history.js";
import { Link } from "./link.js";
import { AccuracyMap } from "./map.js";
import { Numbers } from "./numbers.js";
import { followTheme } from "./palette.js";
import { Placement } from "./placement.js";
import { Player } from "./player.js";
import { Notes, Recordings } from "./recordings.js";
import { Plots } from "./plots.js";
import { Strips } from "./strips.js";
import { Timeline } from "./timeline.js";
import { Trace } from "./trace.js";
import { View3d } from "./view3d.js";

const NUMBERS_EVERY_MS = 100;

let hello = null;
let report = { report: null };
let playerState = null;
let board = remembered("board") ?? 0;
/** @type {(object | null)[]} by board */
let heads = [null];
let histories = [new History()];
let traces = [new Trace()];
let numbersAt_ms = -Infinity;
let numbersTimer = 0;
let isScheduled = false;
/** When the last frame of any board came. */
let heardAt_ms = 0;
/** Whether more than a new pose is to be drawn. */
let isUrgent = true;
/** What the animation frame has to draw besides the frame. */
let isReportNew = true;

const isScene = () => hello?.source === "scene";
const send = (request) => {
  const isSent = link.send(request);
  if (!isSent && request.kind !== "pose") banner.notice("request", "Not connected: the request was not sent.");
  return isSent;
};

const banner = new Banner(reportChanged);
const numbers = new Numbers();
const daemon = new Daemon();
const findings = new Findings();
const recorder = new Recorder(send, () => board);
const player = new Player(send);
const recordings = new Recordings(send, () => link.token);
const notes = new Notes(send, () => {
  const [shown, kept] = [timeline.shown, histories[board]];
  const sinceLast_s = (performance.now() - heardAt_ms) / 1e3;
  return timeline.isPaused ? Math.max(kept.last.time_s - shown.history.at(shown.index).time_s + sinceLast_s, 0) : 0;
});
const guide = new Guide(send);
const view = new View3d(byId("view"), byId("view-words"), byId("view-notes"), schedule);
const strips = new Strips(byId("strips"), schedule);
const plots = new Plots(plotsChanged, (time_s) => timeline.pick(time_s));
const timeline = new Timeline(() => ({ histories, traces }), () => board, (isLive) => {
  numbersAt_ms = -Infinity;
  if (isLive) plots.follow();
  reportChanged();
});
const placement = new Placement(send, () => {
  map.changed();
  schedule();
});
const map = new AccuracyMap(send, () => placement.place);
const goHome = attachGestures(byId("view"), view, schedule, placement);
followTheme(byId("theme"), () => {
  plots.changed();
});
const link = new Link(received, (state) => {
  if (state.state !== "open") {
    placement.answered();
    map.answered();
  }
  reportChanged();
});

function received(message) {
  const take = takers[message.kind];
  // A newer daemon may say more than this page knows.
  if (take) take(message);
  schedule(message.kind !== "frame" || isScene());
}

const takers = {
  hello(message) {
    hello = message;
    banner.forget("notice");
    heads = message.boards.map(() => null);
    histories = message.boards.map(() => new History(message.history_s, message.frames_hz));
    traces = message.boards.map(() => new Trace(message));
    board = Math.min(board, Math.max(message.boards.length - 1, 0));
    playerState = null;
    report = { report: null };
    findings.take(null);
    if (heads.length === 0) [heads, histories, traces] = [[null], [new History()], [new Trace()]];
    if (timeline.isPaused) timeline.live();
    byId("board").replaceChildren(...message.boards.map((name, i) => new Option(name, i)));
    byId("board").value = board;
    show(byId("board-choice"), message.boards.length > 1);
    document.body.dataset.source = message.source;
    for (const id of ["timeline", "plot-panel"]) show(byId(id), !isScene());
    show(byId("drag-panel"), isScene());
    setHead();
  },
  head(message) {
    heads[message.board] = message;
    clear(message.board);
    if (message.board === board) setHead();
  },
  frame(frame) {
    heardAt_ms = performance.now();
    keep(frame);
    histories[frame.board]?.push(frame);
    guide.frame(frame);
    if (isScene()) placement.answered();
  },
  history(message) {
    traces[message.board]?.put(message);
    for (const frame of message.frames ?? []) keep(frame);
    if (message.frames) histories[message.board]?.merge(message.frames);
  },
  report(message) {
    report = message;
    findings.take(message);
    plots.follows(message.report.started_utc_ns);
    isReportNew = true;
  },
  player(message) {
    playerState = message;
    isReportNew = true;
  },
  cleared(message) {
    timeline.live();
    clear(message.board);
  },
  recordings: (message) => recordings.take(message),
  download: (message) => recordings.download(message),
  noted: ({ text }) => notes.noted(text),
  calibration: (message) => guide.take(message),
  map: (message) => map.take(message),
  missed: ({ frames }) => banner.missed(frames),
  notice: ({ text }) => banner.notice("notice", `${text}.`),
  refused({ reason }) {
    banner.notice("request", `Refused: ${reason}.`);
    guide.refused();
    if (isScene()) placement.answered();
    map.answered();
  },
};

/** Puts the bins of a frame in their place; nothing else needs them. */
function keep(frame) {
  traces[frame.board]?.put(frame);
  frame.fine = frame.coarse = undefined;
}

function clear(number) {
  histories[number]?.clear();
  traces[number]?.clear();
}

function plotsChanged() {
  numbersAt_ms = -Infinity;
  schedule();
}

function setHead() {
  const head = heads[board] ?? null;
  view.setHead(head);
  strips.setHead(head);
  guide.setHead(head);
  const name = head && `${head.scene}${head.calibrated ? ", calibrated" : isScene() ? "" : ", not calibrated"}`;
  write(byId("scene-name"), name ?? "");
  if (head && isScene()) placement.setHead(head);
  numbersAt_ms = -Infinity;
  reportChanged();
}

function choose(next) {
  board = next;
  remember("board", next);
  plots.reset();
  byId("board").value = next;
  timeline.boardChanged();
  setHead();
}

function reportChanged() {
  isReportNew = true;
  schedule();
}

function schedule(urgent = true) {
  isUrgent ||= urgent;
  if (isScheduled) return;
  isScheduled = true;
  requestAnimationFrame(draw);
}

function draw(now_ms) {
  isScheduled = false;
  link.acknowledge();
  const { history, index } = timeline.shown;
  const frame = history.at(index);
  const isDue = now_ms - numbersAt_ms >= NUMBERS_EVERY_MS;
  view.draw(frame, isScene() ? null : { history, index }, isScene() ? placement.pose : null, isDue);
  if (isDue || isUrgent) {
    strips.draw(frame);
    if (!isScene()) plots.draw(timeline.trace, timeline.isPaused && frame ? frame.time_s : null);
  }
  isUrgent = false;
  clearTimeout(numbersTimer);
  if (isDue) {
    numbers.draw(frame, isScene());
    timeline.draw(plots.isHeld);
    numbersAt_ms = now_ms;
  } else {
    // Should this be the last frame for a while, its numbers and curves come as well.
    numbersTimer = setTimeout(() => schedule(), NUMBERS_EVERY_MS);
  }
  if (!isReportNew) return;
  isReportNew = false;
  drawReport(frame);
}

function drawReport(frame) {
  const state = report.report?.boards[board];
  const faults = state?.head?.findings ?? [];
  strips.setHealth(faults, state?.head?.cells ?? []);
  findings.draw(state, isScene());
  daemon.draw(report.report, board);
  recorder.draw(report.report?.recorder, state?.frame, hello, link.state.state === "open");
  player.draw(playerState, hello);
  recordings.draw(report.report?.recorder, hello);
  guide.draw(report.report?.recorder, hello);
  notes.draw(report.report?.recorder, playerState, hello, timeline.isPaused);
  banner.draw({ link: link.state, hello, board: isScene() ? null : state, frame, isPaused: timeline.isPaused });
}

byId("board").addEventListener("change", ({ target }) => choose(Number(target.value)));
byId("help").addEventListener("click", () => byId("keys").showModal());
for (const [name, sign] of CELL_STATES) byId("signs").append(make("dt", "", sign), make("dd", "", name));

const keys = {
  " ": () => (hello?.source === "replay" && !timeline.isPaused ? player : timeline).toggle(),
  l: () => timeline.live(),
  ",": () => timeline.step(-1),
  ".": () => timeline.step(1),
  b: () => choose((board + 1) % heads.length),
  m: () => plots.toggleMarks(),
  p: () => player.toggle(),
  "?": () => byId("keys").showModal(),
};
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || takesKeys(event.target)) return;
  const isPress = event.key === " " && event.target.tagName === "BUTTON";
  const act = keys[event.key.toLowerCase()];
  if (isPress) return;
  if (act && !(isScene() && " l,.".includes(event.key.toLowerCase()))) act();
  else if (!goHome(event.key)) return;
  event.preventDefault();
});
