/**
 * Board and daemon: link, rates, losses by place, latency, lag, clock; and the recording.
 */
import { byId, show, write } from "./dom.js";
import { bytes, count, engineering, fixed } from "./format.js";
import { facts } from "./numbers.js";

const FACTS = [
  "Board", "Link", "Rate", "Scans", "Lost on the board", "Lost on the link", "Lost on the host", "Latency",
  "of which link, host", "Lag", "Clock", "Trigger input", "Health of the board", "Its last message", "Program",
];

export class Daemon {
  #write = facts(byId("facts"), FACTS);

  /** @param {object | null} report @param {number} board */
  draw(report, board) {
    const state = report?.boards[board];
    show(byId("facts"), Boolean(state));
    if (!state) return;
    const { link, losses, lag, clock, vitals, trigger, complaint, rates } = state;
    const { board: onBoard, link: onLink, host: onHost } = losses;
    const damaged = onLink.bad_checksum + onLink.misframed + onLink.overlong;
    this.#write({
      "Board": `${state.name}: ${state.board || "unknown"}, firmware ${state.firmware || "unknown"}`,
      "Link": `${link.state}${link.reason ? `: ${link.reason}` : ""}${link.reconnects ? `, ${link.reconnects} reconnects` : ""}`,
      "Rate": `${rates.device_hz == null ? "–" : fixed(rates.device_hz, 1)} Hz by the board, ${fixed(rates.host_hz, 1)} Hz by the host`,
      "Scans": count(state.scans),
      "Lost on the board": `${count(onBoard.scans_dropped)} dropped, ${count(onBoard.scans_lost)} in acquisition, ${count(onBoard.adc_overruns)} overruns`,
      "Lost on the link": `${count(onLink.scans)} scans, ${count(damaged)} packets damaged, ${count(onLink.unreadable)} unreadable, ${count(onLink.scans_repeated)} scans repeated`,
      "Lost on the host": `${bytes(onHost.bytes_unrecorded)} unrecorded, ${count(onHost.poses_unsent)} poses unsent, ${count(lag.skipped_scans)} scans skipped`,
      "Latency": quantiles(state.latencies.total),
      "of which link, host": `${quantiles(state.latencies.link)}; ${quantiles(state.latencies.host)}`,
      "Lag": lag.behind
        ? `behind for ${engineering(lag.behind_s, "s")}, ${count(lag.waiting_scans)} scans wait`
        : lag.output_blocked ? "standard output is read too slowly" : "none",
      "Clock": clock.uncertainty_s == null
        ? "not known yet"
        : `± ${engineering(clock.uncertainty_s, "s")}, drift ${fixed(clock.drift_ppm, 2, { plus: true })} ppm${clock.contradicts_crystal ? ", contradicts its crystal" : ""}`,
      "Trigger input": trigger && `${count(trigger.edges)} edges, ${trigger.is_high ? "high" : "low"} since ${fixed(trigger.last_device_time_s, 4)} s${trigger.missed || trigger.dropped ? `; ${count(trigger.missed)} or more came too fast, ${count(trigger.dropped)} were dropped` : ""}`,
      "Health of the board": vitals && `${fixed(vitals.supply_v, 2)} V, ${fixed(vitals.temperature_k - 273.15, 0)} °C, ${fixed(vitals.cpu_load * 100, 0)} % CPU`,
      "Its last message": complaint && complaint.text,
      "Program": `${report.program} ${report.version}, up ${duration(report.uptime_s)}${report.process ? `, ${bytes(report.process.resident_bytes)}` : ""}`,
    });
  }
}

/** Of the last second; if no pose of it had a known instant, of all poses before. */
function quantiles({ recent, total }) {
  const latency = recent?.count ? recent : total;
  if (!latency?.count) return "–";
  const span = recent?.count ? "" : " (none in the last second)";
  return `${engineering(latency.p50_s, "s")} median, ${engineering(latency.p99_s, "s")} for 99 %${span}`;
}

function duration(seconds) {
  const whole = Math.floor(seconds);
  const parts = [[86400, "d"], [3600, "h"], [60, "min"], [1, "s"]].map(([size, unit], i, all) => [
    Math.floor((i === 0 ? whole : whole % all[i - 1][0]) / size),
    unit,
  ]);
  const first = Math.max(parts.findIndex(([amount]) => amount > 0), 0);
  return (parts[first][0] ? parts.slice(first, first + 2) : parts.slice(-1)).map(([amount, unit]) => `${amount} ${unit}`).join(" ");
}

/** The buttons that change something: recording, and the zero of the frame. */
export class Recorder {
  #isRecording = false;

  /** @param {(request: object) => void} send @param {() => number} board the one shown */
  constructor(send, board) {
    byId("zero-frame").addEventListener("click", () => send({ kind: "set_frame", board: board(), over_s: 1 }));
    byId("undo-frame").addEventListener("click", () => send({ kind: "set_frame", board: board(), over_s: null }));
    byId("record").addEventListener("click", () => send({ kind: "record", on: !this.#isRecording }));
  }

  /** @param {object | null} recorder of the report @param {object | undefined} frame of the board shown
   * @param {object | null} hello @param {boolean} isOpen */
  draw(recorder, frame, hello, isOpen) {
    const isLive = hello?.source === "run";
    show(byId("recorder"), isLive);
    show(byId("frame"), Boolean(isLive && hello.may_write && frame));
    if (frame) write(byId("frame-words"), `frame ${frame.name}${frame.zero ? `; ${frame.zero}` : ""}`);
    if (!isLive) return;
    this.#isRecording = recorder?.state === "recording";
    const button = byId("record");
    write(button, this.#isRecording ? "■ Stop recording" : "● Record");
    const obstacle = !isOpen ? "not connected" : !hello.may_write ? "this page may only look: its address had no token" : "";
    button.disabled = obstacle !== "";
    button.title = obstacle;
    const words = [
      obstacle,
      this.#isRecording || recorder?.bytes ? `${recorder.file ?? ""}, ${bytes(recorder.bytes)}` : "",
      recorder?.state === "failed" ? `the recording failed: ${recorder.reason ?? "no reason given"}` : "",
      recorder?.bytes_dropped ? `${bytes(recorder.bytes_dropped)} not recorded` : "",
    ];
    write(byId("recording"), words.filter(Boolean).join("; ") || "not recording");
  }
}
