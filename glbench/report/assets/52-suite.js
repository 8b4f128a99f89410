// All tasks of a suite together: normalised scores, how often an agent reaches a score, and who beats whom.

const overallState = { key: "rank", direction: "ascending" };
const usedState = { key: PROFIT, direction: "descending" };
const suiteHidden = new Set();
let closeUp = true;

const scoreBar = (interval, range, agent, isRange) => bar({ mean: interval[0], low: interval[1], high: interval[2] }, range, agent, isRange);
const score = (value) => number(value, 3);
// Narrower intervals are not shown: another season or training can move a score by more, and no interval over draws knows that.
const scoreSpan = (isRange, [, low, high]) => (isRange ? (high > low ? `${score(low)} \u2194 ${score(high)}` : "") : high - low >= D.score_step ? `${number(low, 2)} to ${number(high, 2)}` : "");
const trainingsWords = ({ trainings: [fewest, most] }) => (most < 2 ? "" : fewest === most ? `${most} trainings` : `${fewest} to ${most} trainings`);
const chance = (p) => (p > 0.99 ? ">\u00a099\u00a0%" : p < 0.01 ? "<\u00a01\u00a0%" : `${number(100 * p, 0)}\u00a0%`);
const agentHead = (name, extra = null) => h("th", { scope: "row", class: "agent" }, swatch(name), h("a", { href: link("agent", name) }, breakable(name)), extra);

const suiteAgent = (row) => agentHead(row.agent, [row.missing.length ? h("span", { class: "of", title: sentence(row.missing.map((id) => TASKS[id]?.short ?? id)) }, `lacks ${row.missing.length > 2 ? plural(row.missing.length, "task") : sentence(row.missing.map((id) => TASKS[id]?.short ?? id))}`) : null, trainingsWords(row) ? h("span", { class: "of" }, trainingsWords(row)) : null]);

const AGENT_COLUMN = { key: "agent", label: "Agent", value: (row) => row.agent, left: true, start: "ascending", className: "agent", explain: [h("b", {}, "Agent"), ": open one to see its days, its season and its money."], cell: suiteAgent };
const SCORE_COLUMNS = [["mean", "Mean", "Score"], ["iqm", "IQM", "IQM"], ["median", "Median", "Median"], ["optimality_gap", "Optimality gap", "Optimality gap"]];

// Only for suites whose tasks all score money, and only at the tasks' prices: at others, other runs may be the best known.
const moneyColumn = ([key, label, start], rows) => {
  const ends = ([center, low, high]) => ({ mean: center, low, high }), range = barRange(rows.map((row) => (row[key] ? ends(row[key]) : UNKNOWN)), rows.map((row) => row.agent), key === "regret" ? "low" : "high");
  return {
    key, label, unit: "EUR/m\u00b2", value: (row) => row[key]?.[0] ?? null, start, explain: otherWords(label),
    cell: (row) => (row[key] ? h("td", {}, number(row[key][0], 2), bar(ends(row[key]), range, row.agent), h("span", { class: "of" }, row[key][2] > row[key][1] ? `${number(row[key][1], 2)} to ${number(row[key][2], 2)}` : "")) : h("td", {}, "\u2013")),
  };
};

const scoreTable = (suite) => {
  const shown = suite.rows.filter((row) => row.rank !== null), rows = suite.rows;
  const column = ([key, label, word]) => {
    const drawn = shown.length > 2 ? shown : rows, range = barRange(drawn.map(({ [key]: [center, low, high] }) => ({ mean: center, low, high })), drawn.map((row) => row.agent), key === "optimality_gap" ? "low" : "high"), isRange = (row) => key !== "mean" && row.trainings[1] > 1;
    return {
      key, label, value: (row) => row[key][0], start: key === "optimality_gap" ? "ascending" : "descending", explain: otherWords(word),
      cell: (row) => h("td", {}, score(row[key][0]), scoreBar(row[key], range, row.agent, isRange(row)), h("span", { class: "of" }, scoreSpan(isRange(row), row[key]))),
    };
  };
  return sortable({
    caption: `${suiteTitle(suite.name)}: ${suite.scale} ${suite.in_money ? `Numbers below a score are its 95 % interval over ${wordsOf(suite).draws}, and over trainings, if there are several.` : `Numbers below a score are a 95 % interval over ${wordsOf(suite).draws}, of a mean also over trainings, or the lowest and the highest training (\u2194); intervals narrower than ${D.score_step} are left out, because ${wordsOf(suite).beyond} can move a score by more.`}`,
    rows, state: overallState, className: "ranks scores board", rowClass: (row) => (row.rank === null ? "unranked" : null),
    columns: [
      { key: "rank", label: "#", value: (row) => row.rank, start: "ascending", className: "rank", explain: otherWords("Rank"), cell: (row) => h("td", { class: "rank" }, row.rank ?? "\u2013") },
      AGENT_COLUMN,
      ...(suite.in_money ? [["mean", "Mean score", "descending"]].map((one) => moneyColumn(one, shown.length ? shown : rows)) : SCORE_COLUMNS.map(column)),
      ...[["against_rules", "More than the rules", "descending"], ["regret", "Regret", "ascending"]].filter(([key]) => rows.some((row) => row[key])).map((one) => moneyColumn(one, shown.length ? shown : rows)),
      { key: "reversal", label: "P(reversed)", value: (row) => row.reversal, start: "ascending", explain: otherWords("P(reversed)"), cell: (row) => h("td", {}, row.reversal === null ? "\u2013" : chance(row.reversal)) },
      { key: "runs", label: "Runs", value: (row) => row.runs, explain: [h("b", {}, "Runs"), ": of all tasks together. Failed ones count."], cell: (row) => h("td", {}, number(row.runs, 0), row.figures?.failed ? h("span", { class: "of" }, `${row.figures.failed} failed`) : null) },
    ],
  });
};

const usedTable = (suite) => {
  const rows = suite.rows.filter((row) => row.figures);
  const metricColumn = (metric) => ({
    key: metric.name, label: metric.label, unit: metric.unit || "\u00a0", value: (row) => row.figures[metric.name], start: metric.better === "low" ? "ascending" : "descending",
    explain: explained(metric), cell: (row) => h("td", {}, number(row.figures[metric.name] ?? null, metric.decimals)),
  });
  return sortable({
    caption: "What they earned, grew and used: means over the tasks with results", rows, state: usedState, className: "ranks board", columns: [
      AGENT_COLUMN,
      ...wordsOf(suite).columns.filter((metric) => metric.kind !== "score" && rows.some((row) => metric.name in row.figures)).map(metricColumn),
    ],
  });
};

// A drawing in the page's own colours that is as wide as its place.
const svg = (tag, attributes = {}, ...children) => {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) if (value !== null) element.setAttribute(name, value);
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined));
  return element;
};

const profileDrawing = (suite, width, height) => {
  const left = 46, right = 12, top = 12, bottom = 42, agents = Object.keys(suite.profiles).filter((name) => !suiteHidden.has(name));
  const xs = suite.thresholds, last = xs.at(-1), from = closeUp ? closeUpFrom(suite) : xs[0];
  const x = (value) => left + ((value - from) / (last - from)) * (width - left - right), y = (share) => top + (1 - share / 1000) * (height - top - bottom);
  const inside = xs.map((_, i) => i).filter((i) => xs[i] >= from || xs[i + 1] >= from), place = (i) => Math.max(x(xs[i]), left).toFixed(1);
  const path = (values, order = inside) => order.map((i) => `${place(i)},${y(values[i]).toFixed(1)}`).join(" L");
  const step = [0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.25, 0.5, 1].find((one) => (last - from) / one <= (width < 480 ? 4 : 8)) ?? 2;
  const ticks = Array.from({ length: 40 }, (_, i) => (Math.ceil(from / step - 1e-9) + i) * step).filter((value) => value <= last + 1e-9);
  return svg("svg", { viewBox: `0 0 ${width} ${height}`, width, height, "aria-hidden": "true", class: "drawing" },
    [0, 250, 500, 750, 1000].map((share) => [svg("line", { x1: left, x2: width - right, y1: y(share), y2: y(share), class: "rule" }), svg("text", { x: left - 8, y: y(share) + 4, "text-anchor": "end" }, `${share / 10} %`)]),
    ticks.map((value) => [svg("line", { x1: x(value), x2: x(value), y1: top, y2: height - bottom, class: "rule" }), svg("text", { x: x(value), y: height - bottom + 17, "text-anchor": "middle" }, number(value, step < 0.01 ? 3 : step < 0.1 ? 2 : step === 0.25 ? 2 : 1))]),
    svg("text", { x: (left + width - right) / 2, y: height - 5, "text-anchor": "middle" }, width < 480 ? "normalised score" : "normalised score: 1 is the best known"),
    agents.map((name) => {
      const [share, low, high] = suite.profiles[name];
      return svg("g", { "data-agent": name, style: `--colour: ${colourOf(name)}` },
        svg("path", { d: `M${path(high)} L${path(low, [...inside].reverse())} Z`, class: "band" }),
        svg("path", { d: `M${path(share)}`, class: "line", "stroke-dasharray": DASHES[cycleOf(name)] || null }));
    }));
};

// Where the ranked agents that do something begin to differ: a little below the lowest of their scores.
const closeUpFrom = (suite) => {
  const lows = suite.rows.filter((row) => row.rank !== null && row.mean[0] > 0.5).map((row) => { const i = suite.profiles[row.agent][0].findIndex((share) => share < 1000); return suite.thresholds[Math.max(i - 1, 0)]; });
  return Math.max(suite.thresholds[0], (lows.length ? Math.min(...lows) : 0) - 0.01);
};

const profilePart = (suite) => {
  const place = h("div", { class: "drawn", role: "img", "aria-label": `Performance profiles. ${suite.rows.filter((row) => row.rank !== null).map((row) => `${row.agent}: half of its runs score above ${score(half(suite, row.agent))}`).join("; ")}.` });
  const left = h("p", { class: "small soft" });
  const draw = () => {
    const width = Math.floor(place.clientWidth), from = closeUp ? closeUpFrom(suite) : -Infinity;
    const off = Object.keys(suite.profiles).filter((name) => !suiteHidden.has(name) && suite.thresholds.every((value, i) => value < from || suite.profiles[name][0][i] < 5));
    left.textContent = off.length ? `\u25c0 Off the scale to the left: ${off.map((name) => `${name}, half of its runs score above ${score(half(suite, name))}`).join("; ")}.` : "";
    if (width > 60) place.replaceChildren(profileDrawing(suite, width, width < 480 ? 260 : 330));
  };
  place.redraw = draw;
  new ResizeObserver(draw).observe(place);
  const legend = h("ul", { class: "legend", "aria-label": "Agents in the figure" }, Object.keys(suite.profiles).map((name) => h("li", {}, h("button", {
    type: "button", "aria-pressed": String(!suiteHidden.has(name)),
    onclick: (event) => { suiteHidden.has(name) ? suiteHidden.delete(name) : suiteHidden.add(name); event.currentTarget.setAttribute("aria-pressed", String(!suiteHidden.has(name))); draw(); },
  }, swatch(name), name))));
  const lens = h("button", { class: "plain", type: "button", id: "close-up", "aria-pressed": String(closeUp), onclick: (event) => { closeUp = !closeUp; event.currentTarget.setAttribute("aria-pressed", String(closeUp)); draw(); } }, "Close up on the best");
  const shares = [0.5, 0.8, 0.9, 0.95, 1];
  const shareAbove = (name, wanted) => suite.profiles[name][0][Math.max(0, suite.thresholds.findLastIndex((value) => value <= wanted + 1e-9))];
  return [
    h("h2", { id: "profiles" }, "How often does an agent reach a score?"),
    h("p", { class: "soft" }, `Go along the scores: the height of a line is the share of an agent\u2019s runs that score more than that, averaged over the tasks (a performance profile), the band its 95 % interval over the ${wordsOf(suite).draws} and these trainings. A line that is higher everywhere belongs to the better agent; a slow fall means luck, a sudden one a steady hand.`),
    legend, h("div", { class: "fields tight" }, lens), h("figure", {}, place, left),
    h("details", { class: "data" }, h("summary", {}, "This figure as a table"), plainTable("Share of runs with a score above", ["Agent", ...shares.map((value) => number(value, 2))], Object.keys(suite.profiles).map((name) => [breakable(name), ...shares.map((value) => `${number(shareAbove(name, value) / 10, 0)}\u00a0%`)]))),
  ];
};
const half = (suite, name) => { const i = suite.profiles[name][0].findIndex((share) => share < 500); return suite.thresholds[i < 0 ? suite.thresholds.length - 1 : i]; };

// Probability of improvement of one agent over every other.
const improvementPart = (suite, chosen) => {
  const agents = suite.rows.filter((row) => row.rank !== null).map((row) => row.agent);
  if (agents.length < 2) return null;
  const one = agents.includes(chosen) ? chosen : agents[0];
  const rows = suite.improvements.filter(([first]) => first === one);
  const words = (p) => (p[1] > 0.5 ? "more often better" : p[2] < 0.5 ? "more often worse" : "not told apart");
  return [
    h("h2", {}, "Who beats whom?"),
    h("p", { class: "soft" }, `The probability that one agent scores above another in the same run, averaged over the tasks, with its 95 % interval over the ${wordsOf(suite).draws}, and over trainings where there are several. 50 % is a draw. It says how often, not by how much, and nothing about ${wordsOf(suite).beyond}.`),
    h("div", { class: "fields" }, agentField("This agent", one, (value) => go("overall", suite.name, value), agents, "choose-improver")),
    h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Probability of improvement" }, h("table", { class: "odds" },
      h("caption", {}, h("span", {}, `How often a run of ${one} beats a run of the others`)),
      h("thead", {}, h("tr", {}, h("th", { scope: "col", class: "left" }, "against"), h("th", { scope: "col" }, "Probability"), h("th", { scope: "col", class: "wide-cell" }, h("span", { class: "ends" }, h("span", {}, "0 %"), h("span", {}, "draw"), h("span", {}, "100 %"))), h("th", { scope: "col" }, "95 % interval"), h("th", { scope: "col", class: "left" }, `${one} is`))),
      h("tbody", {}, rows.map(([, other, ...p]) => h("tr", {}, h("th", { scope: "row" }, swatch(other), h("a", { href: link("agent", other) }, breakable(other))), h("td", {}, chance(p[0])),
        h("td", {}, h("span", { class: "odd", "aria-hidden": "true", "data-agent": one, style: { "--colour": colourOf(one) } }, h("i", { style: { left: `${100 * p[1]}%`, width: `${100 * (p[2] - p[1])}%` } }), h("b", { style: { left: `${100 * p[0]}%` } }))),
        h("td", {}, chance(p[1]) === chance(p[2]) ? "\u2013" : `${number(100 * p[1], 0)} to ${number(100 * p[2], 0)}\u00a0%`), h("td", { class: "left" }, words(p))))))),
  ];
};

const suitePage = (name, chosen) => {
  if (!D.suites.length) return { title: "Overall", content: [h("h1", {}, "Who is best over all tasks?"), h("p", {}, "No suite has results that can be averaged yet. It takes results on a published task that scores money, or has a scale.")] };
  const suite = D.suites.find((one) => one.name === name) ?? D.suites[0];
  return {
    title: "Overall",
    content: [
      h("h1", {}, "Who is best over all tasks?"),
      h("p", { class: "story" }, suiteWords(suite)),
      D.suites.length > 1 ? h("div", { class: "fields" }, select("Suite", D.suites.map((one) => ({ value: one.name, text: `${suiteTitle(one.name)} (${plural(one.tasks.length, "task")})` })), suite.name, (value) => go("overall", value), "choose-suite")) : null,
      suite.tasks.some((id) => pricesDiffer(TASKS[id])) ? h("p", { class: "note" }, "These scores are at the tasks\u2019 prices; the other prices hold on the leaderboard of each task.") : null,
      scoreTable(suite).element, usedTable(suite).element, suiteViolations(suite), suite.thresholds.length ? profilePart(suite) : null, improvementPart(suite, chosen),
      aboutTable(suite.rows.filter((row) => row.figures), AGENT_COLUMN, (row) => ({ ...row.figures, steps: row.figures.training })),
    ],
  };
};
