/**
 * What is wrong, gravest first, and what to do about it.
 */
import { byId, make } from "./dom.js";

const SIGNS = { failed: ["✕", "bad", "failed"], warning: ["▽", "warn", "warning"] };

export class Findings {
  #shown = "";

  /** @param {object[] | null} findings of the report; null before the first @param {{text: string}[]} faults of the head of the board shown */
  draw(findings, faults) {
    if (!findings) return this.#write([make("li", "", "No report yet.")]);
    const wrong = findings.filter(({ verdict }) => verdict in SIGNS);
    const lines = wrong.map(({ name, finding, next_step }) => `${name}: ${finding}${next_step ? `; ${next_step}` : ""}`);
    // A fault of the head may be among the findings already, with the board before its place.
    const others = faults.filter(({ text }) => !lines.some((line) => line.endsWith(text)));
    const key = JSON.stringify([lines, others, findings.length]);
    if (key === this.#shown) return;
    const items = [
      ...wrong.map(({ name, verdict, finding, next_step }) => item(verdict, `${name}: ${finding}`, next_step)),
      ...others.map(({ text }) => {
        const [what, ...steps] = text.split("; ");
        return item("failed", what, steps.join("; "));
      }),
    ].sort((a, b) => Number(a.dataset.grade === "warn") - Number(b.dataset.grade === "warn"));
    this.#write(items.length ? items : [make("li", "", "Nothing is wrong.")]);
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
