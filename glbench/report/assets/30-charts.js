// Charts: plotly.js is opened when the first chart comes into view, and drawn in the colours of the theme.

const COLOURS = {
  light: ["#1d6b47", "#c2452a", "#2f64ad", "#966000", "#7a4fa3", "#0f7f86", "#b23a77", "#5b655f"],
  dark: ["#7fd1a5", "#ff8f70", "#8fb8f5", "#e8b44f", "#c5a1ee", "#63c9cf", "#f08fbd", "#b3beb7"],
};
const SYMBOLS = ["circle", "square", "diamond", "triangle-up", "cross", "x", "triangle-down", "star"];
// More agents than colours: those of the second and third round have open symbols and broken lines.
const DASHES = ["", "7 4", "2 3"];
const cycleOf = (agent) => Math.floor(AGENTS[agent].index / 8) % 3;
const symbolOf = (agent) => SYMBOLS[AGENTS[agent].index % 8] + (cycleOf(agent) ? "-open" : "");
const dashOf = (agent) => ["solid", "dash", "dot"][cycleOf(agent)];
let printing = false, themeBefore;
const darkNow = () => {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
};
const colourAt = (index) => COLOURS[darkNow() ? "dark" : "light"][index % 8];
const colourOf = (agent) => colourAt(AGENTS[agent].index);
const variable = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
const faded = (colour, share) => colour + Math.round(share * 255).toString(16).padStart(2, "0");

let library = null;
const plotly = () => {
  library ??= unzip("plotly").then((text) => {
    const script = document.createElement("script");
    script.textContent = text;
    document.head.append(script);
    return window.Plotly;
  });
  return library;
};

const CONFIG = { displayModeBar: false, responsive: true, scrollZoom: false, doubleClick: "reset", locale: "en" };
const axis = (more = {}) => ({
  gridcolor: variable("grid"), zerolinecolor: variable("line"), linecolor: variable("line"), tickcolor: variable("line"),
  ticks: "", automargin: true, fixedrange: true, nticks: 6, separatethousands: true, ...more,
});
// What an axis shows; small, so that charts stay charts on a phone.
const axisTitle = (text) => (text ? { text: plain(text), standoff: 4, font: { size: 11 } } : undefined);
const layout = ({ xaxis, yaxis, ...more } = {}) => ({
  font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: variable("soft") },
  paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, hovermode: "x unified",
  hoverlabel: { bgcolor: variable("card"), bordercolor: variable("line"), font: { color: variable("ink") } },
  margin: { l: 8, r: 10, t: 10, b: 8 }, separators: ".,", dragmode: false,
  ...more, xaxis: axis(xaxis), yaxis: axis(yaxis),
});

const drawn = new Map();
const seen = new IntersectionObserver((entries) => {
  for (const entry of entries) if (entry.isIntersecting) { seen.unobserve(entry.target); draw(entry.target); }
}, { rootMargin: "300px" });

// Without waiting where plotly.js is open already: nothing waits before printing.
const draw = (element) => (window.Plotly ? drawNow(element) : plotly().then(() => element.isConnected && drawNow(element)));
const drawNow = (element) => {
  const { traces, layout: look } = drawn.get(element)();
  return window.Plotly.react(element, traces, { ...look, height: Number(element.dataset.height), width: printing ? element.clientWidth : undefined }, CONFIG).then(() => { element.dataset.drawn = "yes"; });
};

// A figure with a caption and, for those who cannot see it, what it shows. `build` gives traces and layout in today's colours.
const chart = (caption, build, { height = 210, says = "", note = null } = {}) => {
  const element = h("div", { class: "chart", "data-height": height, role: "img", "aria-label": says || "Chart", style: { "min-height": `${height}px` } });
  drawn.set(element, build);
  seen.observe(element);
  return h("figure", {}, h("figcaption", {}, caption), element, note);
};

const forgetCharts = () => {
  for (const element of drawn.keys()) { seen.unobserve(element); if (window.Plotly && element.dataset.drawn) window.Plotly.purge(element); }
  drawn.clear();
};
// Before printing every chart of an open part is drawn, in light colours and as wide as paper; plotly.js is opened early, so that this takes no waiting.
const PAPER = 703; // pixels that A4 has between margins of 12 mm
const PRINT_STYLE = [...document.styleSheets[0].cssRules].find((rule) => rule.media?.mediaText === "print");
const forPaper = (now) => {
  if (printing === now) return;
  printing = now;
  if (now) themeBefore = document.documentElement.dataset.theme;
  if (now || themeBefore) document.documentElement.dataset.theme = now ? "light" : themeBefore;
  else delete document.documentElement.dataset.theme;
  PRINT_STYLE.media.mediaText = now ? "all" : "print"; // what is measured now is what is printed
  document.documentElement.style.width = now ? `${PAPER}px` : "";
  recolour(false);
  for (const place of document.querySelectorAll(".drawn")) place.redraw();
  for (const table of document.querySelectorAll("main .scroll > table")) {
    const wide = table.scrollWidth / table.parentElement.clientWidth;
    table.style.zoom = now && wide > 1 ? (0.99 / wide).toFixed(3) : "";
  }
  if (window.Plotly) for (const element of drawn.keys()) if (element.checkVisibility() && (now || element.dataset.drawn)) draw(element);
};
addEventListener("beforeprint", () => forPaper(true));
addEventListener("afterprint", () => forPaper(false));
const redrawCharts = () => { for (const element of drawn.keys()) if (element.dataset.drawn) draw(element); };
const redrawChart = (element) => { if (element.dataset.drawn) draw(element); };

// Limits as quiet bands outside of which it is too cold, too humid, and so on. They come after the traces.
const limitShapes = (limit) => (limit ? [limit.low, limit.high].map((value) => ({
  type: "line", xref: "paper", x0: 0, x1: 1, yref: "y", y0: value, y1: value, line: { color: variable("warm"), width: 1, dash: "dot" },
})) : []);

// A band between two lines, as one closed trace.
const band = (x, low, high, colour, share) => ({
  type: "scatter", mode: "lines", x: [...x, ...[...x].reverse()], y: [...high, ...[...low].reverse()], fill: "toself",
  fillcolor: faded(colour, share), line: { width: 0 }, hoverinfo: "skip",
});
const line = (x, y, colour, more = {}) => ({ type: "scatter", mode: "lines", x, y, line: { color: colour, width: 2, ...more.line }, ...Object.fromEntries(Object.entries(more).filter(([key]) => key !== "line")) });
