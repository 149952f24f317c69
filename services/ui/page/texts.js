// Texts of the page: one file per language. English is the only one so far.

let texts = {};

export async function load() {
  const answer = await fetch("./texts.en.json");
  texts = await answer.json();
  for (const element of document.querySelectorAll("[data-text]")) {
    element.textContent = say(element.dataset.text);
  }
  for (const element of document.querySelectorAll("[data-label]")) {
    element.setAttribute("aria-label", say(element.dataset.label));
  }
}

// The text of a key, with values in place of {names}.
export function say(key, values = {}) {
  const text = texts[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name) => values[name] ?? "–");
}
