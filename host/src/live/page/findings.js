/**
 * What is wrong, gravest first, and what to do about it; each stays until a minute after it was last true.
 */
import { byId, make } from "./dom.js";
import { count, engineering } from "./format.js";

const SIGNS = { failed: ["✕", "bad", "failed"], warning: ["▽", "warn", "warning"] };
const MEMORY_MS = 60_000;
/** A control loop at 1 kHz misses twenty turns: later poses than these are worth a word. */
const LATE_S = 0.02;

/** Scans of a board that were lost or skipped since its start, by place. */
export function losses({ lag, losses: { board, link } }) {
  return { skipped: lag.skipped_scans, board: board.scans_dropped + board.scans_lost, link: link.scans };
}

/** What is unusual about a board whose poses may be good. */
function oddities({ name, latencies, clock }) {
  const p99_s = latencies.total?.recent?.p99_s ?? 0;
  return [
    p99_s > LATE_S && {
      name: `${name}, poses`,
      finding: `1 % of the poses were sent later than ${engineering(p99_s, "s")} after their instant`,
      next_step: "see from the latencies whether the link or this machine is too slow",
    },
    clock.contradicts_crystal && {
      name: `${name}, board clock`,
      finding: "it contradicts its crystal",
      next_step: "unless this host was suspended or its clock corrected, check the board's crystal",
    },
  ].filter(Boolean).map((finding) => ({ ...finding, verdict: "warning" }));
}

/** Findings and losses of the last minute. Pure but for what it has been told before. */
export class Memory {
  /** Time of each finding when it was last true, by place and words without numbers. */
  #seen = new Map();
  /** Losses of each board at earlier times. */
  #losses = [];

  /** @param {{findings: object[], report: object}} message @param {number} now_ms */
  take({ findings, report }, now_ms) {
    const { boards } = report;
    const present = [...findings.filter(({ verdict }) => verdict in SIGNS), ...boards.flatMap(oddities)];
    for (const [key, { at_ms }] of this.#seen) if (now_ms - at_ms > MEMORY_MS) this.#seen.delete(key);
    const keys = new Set();
    for (const finding of present) {
      const key = `${finding.name}: ${finding.finding.replace(/[\d.]+/g, "")}`;
      keys.add(key);
      // A daemon that starts has no board yet.
      if (boards.length > 0) this.#seen.set(key, { at_ms: now_ms, finding });
    }
    const past = [...this.#seen].filter(([key]) => !keys.has(key)).map(([, { at_ms, finding }]) => {
      // In tens, so that the words change seldom.
      const span_s = 10 * Math.ceil((now_ms - at_ms + 1) / 1e4);
      return { ...finding, verdict: "warning", finding: `in the last ${span_s} s: ${finding.finding}` };
    });
    return [...present, ...past, ...this.#lost(boards, now_ms, report.uptime_s)];
  }

  #lost(boards, now_ms, uptime_s) {
    const totals = boards.map(losses);
    if (this.#losses[0]?.totals.length !== totals.length) {
      // What was lost before the first report is of the last minute, too, if the daemon is younger.
      const none = totals.map(() => ({ skipped: 0, board: 0, link: 0 }));
      this.#losses = [{ at_ms: now_ms, totals: uptime_s * 1e3 < MEMORY_MS ? none : totals }];
    }
    this.#losses.push({ at_ms: now_ms, totals });
    while (this.#losses[1].at_ms <= now_ms - MEMORY_MS) this.#losses.shift();
    const lines = [
      ["skipped", "solver", "skipped: they came faster than they were solved", "close other programs, use --tier paper, or lower the frame rate"],
      ["board", "board", "lost on the board", "see under Board and program where; reset the board"],
      ["link", "link", "lost between board and host", "check cable, hub and port of the board"],
    ];
    return boards.flatMap(({ name }, i) =>
      lines.map(([key, place, what, next_step]) => {
        const lost = totals[i][key] - this.#losses[0].totals[i][key];
        const finding = `in the last minute ${count(lost)} scans were ${what}`;
        return lost > 0 && { name: `${name}, ${place}`, verdict: "warning", finding, next_step };
      }).filter(Boolean));
  }
}

export class Findings {
  #memory = new Memory();
  #findings = null;
  #shown = "";

  /** @param {object | null} message a report with its findings; null: of another daemon */
  take(message) {
    if (!message) this.#memory = new Memory();
    this.#findings = message && this.#memory.take(message, performance.now());
  }

  /** @param {object | undefined} board of the report that is shown @param {boolean} isScene a scene has no report */
  draw(board, isScene) {
    if (!this.#findings) return this.#write([make("li", "", isScene ? "A scene without a board has none." : "No report yet.")]);
    const faults = board?.head?.findings ?? [];
    const lines = this.#findings.map(({ name, finding, next_step }) => `${name}: ${finding}${next_step ? `; ${next_step}` : ""}`);
    // A fault of the head may be among the findings already, with the board before its place.
    const others = faults.filter(({ text }) => !lines.some((line) => line.endsWith(text)));
    const total = board ? Object.values(losses(board)).reduce((sum, lost) => sum + lost, 0) : 0;
    const key = JSON.stringify([lines, others, total]);
    if (key === this.#shown) return;
    const items = [
      ...this.#findings.map(({ name, verdict, finding, next_step }) => item(verdict, `${name}: ${finding}`, next_step)),
      ...others.map(({ text }) => {
        const [what, ...steps] = text.split("; ");
        return item("failed", what, steps.join("; "));
      }),
    ].sort((a, b) => Number(a.dataset.grade === "warn") - Number(b.dataset.grade === "warn"));
    const fine = total ? `Nothing is wrong now; ${count(total)} scans were lost or skipped since the start.` : "Nothing is wrong.";
    this.#write(items.length ? items : [make("li", "", fine)]);
    this.#shown = key;
  }

  #write(items) {
    this.#shown = "";
    byId("findings").replaceChildren(...items);
  }
}

function item(verdict, what, nextStep) {
  const [sign, grade, word] = SIGNS[verdict];
  const mark = make("strong", "", `${sign} ${word} `);
  const element = make("li", "", mark, what);
  if (nextStep) element.append(make("br"), make("span", "next-step", `→ ${nextStep}`));
  element.dataset.grade = grade;
  return element;
}
