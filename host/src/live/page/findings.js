/**
 * What is wrong, gravest first, and what to do about it.
 */
import { byId, make } from "./dom.js";
import { count } from "./format.js";

const SIGNS = { failed: ["✕", "bad", "failed"], warning: ["▽", "warn", "warning"] };

export class Findings {
  #shown = "";

  /** @param {object[] | null} findings of the report; null without one @param {object | undefined} board of the report that is shown @param {boolean} isScene a scene has no report */
  draw(findings, board, isScene) {
    if (!findings) return this.#write([make("li", "", isScene ? "A scene without a board has none." : "No report yet.")]);
    const faults = board?.head?.findings ?? [];
    const skipped = board?.lag.skipped_scans ?? 0;
    const wrong = findings.filter(({ verdict }) => verdict in SIGNS);
    const lines = wrong.map(({ name, finding, next_step }) => `${name}: ${finding}${next_step ? `; ${next_step}` : ""}`);
    // A fault of the head may be among the findings already, with the board before its place.
    const others = faults.filter(({ text }) => !lines.some((line) => line.endsWith(text)));
    const key = JSON.stringify([lines, others, findings.length, skipped]);
    if (key === this.#shown) return;
    const items = [
      ...wrong.map(({ name, verdict, finding, next_step }) => item(verdict, `${name}: ${finding}`, next_step)),
      ...others.map(({ text }) => {
        const [what, ...steps] = text.split("; ");
        return item("failed", what, steps.join("; "));
      }),
    ].sort((a, b) => Number(a.dataset.grade === "warn") - Number(b.dataset.grade === "warn"));
    const fine = skipped ? `Nothing is wrong now; ${count(skipped)} scans were skipped so far.` : "Nothing is wrong.";
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
