// Which page is shown: the part of the address behind #, so that every view can be linked and the back button works.

const link = (...parts) => `#/${parts.filter((part) => part !== "" && part !== undefined).map(encodeURIComponent).join("/")}`;
const go = (...parts) => { location.hash = link(...parts); };

const PAGES = { "": leaderboardPage, overall: suitePage, agents: agentsPage, agent: agentPage, compare: comparePage, tasks: tasksPage, task: taskPage, guide: guidePage, missing: (where = "missing") => missingPage(`No page has the address \u201c${where}\u201d.`) };
const NAVIGATION = [["Leaderboard", "", [""]], ["Overall", "overall", ["overall"]], ["Agents", "agents", ["agents", "agent"]], ["Compare", "compare", ["compare"]], ["Tasks", "tasks", ["tasks", "task"]], ["Guide", "guide", ["guide"]]];

const address = () => {
  const written = location.hash.replace(/^#\/?/, "");
  try { return written.split("/").map(decodeURIComponent); } catch { return ["missing", written]; }
};
const parse = () => {
  const [first, ...rest] = address();
  return Object.hasOwn(PAGES, first) ? [first, rest] : ["", [first, ...rest]];
};

// Draw the page of the address. `focus` is the id of what keeps the focus when the page stays the same.
const show = (focus = null) => {
  const [name, parts] = parse();
  forgetCharts();
  const { title, content } = PAGES[name](...parts);
  const main = document.getElementById("main");
  main.replaceChildren(...content.flat(Infinity).filter(Boolean));
  showMeaning(null);
  explainTerms();
  document.title = `${title} \u00b7 glbench`;
  document.getElementById("nav").replaceChildren(...NAVIGATION.map(([label, target, names]) => h("a", { href: link(target), "aria-current": names.includes(name) ? "page" : null }, label)));
  if (focus) document.getElementById(focus)?.focus();
  document.documentElement.dataset.shown = name || "leaderboard";
};

const themeButton = document.getElementById("theme");
const nameTheme = () => { themeButton.textContent = darkNow() ? "Light" : "Dark"; themeButton.setAttribute("aria-label", `Switch to ${darkNow() ? "light" : "dark"} colours`); };
const recolour = (charts = true) => { nameTheme(); for (const one of document.querySelectorAll("[data-agent]")) one.style.setProperty("--colour", colourOf(one.dataset.agent)); if (charts) redrawCharts(); };
themeButton.addEventListener("click", () => {
  const theme = darkNow() ? "light" : "dark";
  document.documentElement.dataset.theme = theme;
  try { localStorage.setItem("glbench-theme", theme); } catch { /* a folder's pages may keep nothing */ }
  recolour();
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => recolour());

let wasAt = null;
addEventListener("hashchange", () => {
  const now = parse()[0];
  const focused = document.activeElement?.id;
  show(focused && focused.startsWith("choose-") && now === wasAt ? focused : null);
  if (now !== wasAt || !focused?.startsWith("choose-")) { scrollTo(0, 0); document.getElementById("main").focus({ preventScroll: true }); }
  wasAt = now;
});
nameTheme();
show();
wasAt = parse()[0];
// The page is loaded when it can be printed whole.
await Promise.all(waiting);
if (drawn.size) await plotly();
