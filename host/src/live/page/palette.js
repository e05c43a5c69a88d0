/**
 * Colours of canvases, and the switch between light and dark.
 *
 * Cells have the colours of every other picture of slitpose: those of Okabe and Ito (2008), which people with the common
 * forms of colour blindness tell apart. Each cell also bears its number. All else follows the custom properties of
 * style.css, read once a change.
 */

const CELLS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8a8a8a"];
/** The same, lighter where a dark page would swallow them. */
const CELLS_ON_DARK = ["#3f9fd8", "#ef7f2e", "#1fbf92", "#dd94bd", "#f0b430", "#7cc8f2", "#a8a8a8"];
const NAMES = ["ink", "soft", "pale", "faint", "paper", "panel", "bad", "warn", "good", "accent", "mask", "tool"];
const KEY = "slitpose-theme";

const prefersDark = matchMedia("(prefers-color-scheme: dark)");

/** @type {Record<string, string>} */
export const colours = {};
let isDark = false;

export const cellColour = (cell) => (isDark ? CELLS_ON_DARK : CELLS)[cell % CELLS.length];
/** From the eighth cell on, colours repeat; dashes tell those apart. */
export const cellDash = (cell) => (cell < CELLS.length ? [] : cell < 2 * CELLS.length ? [5, 3] : [2, 2]);

/** Calls `changed` now and whenever the theme changes; `button` goes round system, light, dark. */
export function followTheme(button, changed) {
  const apply = () => {
    const choice = stored();
    isDark = choice === "dark" || (choice !== "light" && prefersDark.matches);
    document.documentElement.dataset.theme = isDark ? "dark" : "light";
    const style = getComputedStyle(document.documentElement);
    for (const name of NAMES) colours[name] = style.getPropertyValue(`--${name}`).trim();
    button.textContent = { system: "◐ Auto", light: "☀ Light", dark: "☾ Dark" }[choice];
    button.setAttribute("aria-label", `Theme: ${choice}. Change it.`);
    changed();
  };
  button.addEventListener("click", () => {
    const next = { system: "light", light: "dark", dark: "system" }[stored()];
    try {
      localStorage.setItem(KEY, next);
    } catch {
      // Without storage the page follows the system.
    }
    apply();
  });
  prefersDark.addEventListener("change", apply);
  apply();
}

function stored() {
  try {
    const choice = localStorage.getItem(KEY);
    return choice === "light" || choice === "dark" ? choice : "system";
  } catch {
    return "system";
  }
}
