// Terms of the field, explained where they are met first on a page: a tap, a click or the keyboard opens the meaning, and the end of the page, which
// prints, lists them all. They are no button elements: those break no line, and lines break before them.

const TERMS = D.other_words.filter(([, , marks]) => marks.length).map(([word, meaning, marks]) => ({ word, meaning, pattern: new RegExp(`(?<![\\w-])(?:${marks.join("|")})(?![\\w-])`) }));
const NO_TERMS = "code, select, svg, .chart, input, output, h1, #terms, dl.words", INTERACTIVE = "a, button, summary, label, legend";

const explainTerms = () => {
  const main = document.getElementById("main");
  const texts = document.createTreeWalker(main, NodeFilter.SHOW_TEXT), met = new Map();
  for (let node = texts.nextNode(); node; node = texts.nextNode()) {
    if (node.parentElement.closest(NO_TERMS)) continue;
    for (const term of TERMS) {
      if (met.get(term.word) === "open") continue;
      const match = term.pattern.exec(node.data);
      if (!match) continue;
      const closed = node.parentElement.closest(INTERACTIVE);
      met.set(term.word, closed && !closed.matches(".term") ? "listed" : "open");
      if (closed) continue;
      const rest = node.splitText(match.index), button = h("span", { role: "button", tabindex: "0", class: "term", "aria-expanded": "false", "data-term": term.word }, match[0]);
      rest.data = rest.data.slice(match[0].length);
      node.after(button);
      texts.currentNode = node; // the rest comes next
    }
  }
  document.getElementById("terms")?.remove();
  const words = TERMS.filter(({ word }) => met.has(word));
  if (words.length && !main.querySelector("dl.words")) main.append(h("section", { id: "terms" }, h("h2", {}, "Words on this page"), h("dl", { class: "words small" }, words.map(({ word, meaning }) => [h("dt", {}, word), h("dd", {}, meaning)]))));
};

const meaningBox = h("div", { id: "meaning", role: "status", hidden: true });
document.body.append(meaningBox);
const showMeaning = (button) => {
  for (const one of document.querySelectorAll(".term[aria-expanded=true]")) one.setAttribute("aria-expanded", "false");
  meaningBox.hidden = !button;
  if (!button) return;
  button.setAttribute("aria-expanded", "true");
  const { word, meaning } = TERMS.find((term) => term.word === button.dataset.term);
  meaningBox.replaceChildren(h("b", {}, word), `: ${meaning}`);
  const { left, bottom } = button.getBoundingClientRect(), room = document.documentElement.clientWidth - meaningBox.offsetWidth - 12;
  meaningBox.style.left = `${Math.max(12, Math.min(left, room)) + scrollX}px`;
  meaningBox.style.top = `${bottom + scrollY + 6}px`;
};
document.addEventListener("click", ({ target }) => { const button = target.closest?.(".term"); showMeaning(button && button.getAttribute("aria-expanded") !== "true" ? button : null); });
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") showMeaning(null);
  if (!["Enter", " "].includes(event.key) || !event.target.matches?.(".term")) return;
  event.preventDefault(); // a space would scroll
  event.target.click();
});
