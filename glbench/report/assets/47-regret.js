// Regret: how far an agent stays below the best known runs, and whether it gives away profit or breaks limits.

const KNOWN_OF = (task) => (task.best_known.agent === "several" ? "several agents" : task.best_known.agent);
// Of a result, unless the reader changed prices: at these another run may be the best.
const regretOf = (result) => (pricesDiffer(TASKS[result.task]) ? null : result.regret);
const violationWord = (task) => lower(wordsOf(task).metric[PENALTY].label);

// Where not every run has a best known one: which a regret is over.
const regretRuns = (result) => (result.regret?.first ? `over the ${result.regret.first} runs that have a best known one` : "");

const regretColumn = (task, rows) => {
  if (!rows.some((row) => row.result.regret)) return null;
  const { decimals, unit } = wordsOf(task).metric[SCORE], of = (row) => { const found = regretOf(row.result); return found ? { mean: found.total[0], low: found.total[1], high: found.total[2] } : UNKNOWN; };
  return {
    key: "regret", label: "Regret", unit: unit || "\u00a0", value: (row) => of(row).mean, start: "ascending", explain: otherWords("Regret"),
    cell: (row) => {
      const one = of(row);
      const title = one.mean === null ? (row.result.regret ? "at other prices the best known runs are not known" : "no best known runs with these seeds") : [spanWords(row.result, one, decimals + 1), regretRuns(row.result)].filter(Boolean).join(", ");
      return h("td", { title }, number(one.mean, decimals), h("span", { class: "visually-hidden" }, ` (${title})`));
    },
  };
};

// Results that are above the best known runs here and there: somebody should know.
const betterNotes = (results) => results.filter((result) => result.regret?.better).map((result) => h("p", { class: "note" },
  h("b", {}, result.agent), ` is above the best known run in ${plural(result.regret.ahead, "run")}: a better plan than the best known. Hand it in: `, h("code", {}, "glbench bound --submit RESULT.json")));

// Both parts in the unit of what ranks: what violations do not explain is profit.
const regretParts = ({ total, violations }) => (violations ? [total[0] - violations[0], violations[0]] : [total[0], 0]);

const regretFigure = (task, rows) => {
  const results = rows.map((row) => row.result).filter((result) => result.regret);
  if (!results.length || pricesDiffer(task)) return null;
  const words = wordsOf(task), { decimals, unit } = words.metric[SCORE], more = unit ? decimals : decimals + 1, ordered = [...results].sort((a, b) => a.regret.total[0] - b.regret.total[0]);
  const parts = ordered.map((result) => regretParts(result.regret));
  const reach = (sign) => parts.map((both) => sum(both.map((part) => Math.max(0, sign * part))));
  const [right, left] = [1, -1].map(reach), ends = [right, left].map((side) => Math.max(1e-9, barRange(side.map((mean) => ({ mean, low: 0, high: mean })), ordered.map((result) => result.agent), "low")[1]));
  // What is longer than the scale is drawn to its end, with its parts in proportion.
  const cut = (part, i) => part * (part > 0 ? Math.min(1, ends[0] / right[i]) : Math.min(1, ends[1] / left[i] || 1));
  const off = ordered.map((_, i) => right[i] > ends[0] * 1.001), kinds = [["Profit given away", "accent", 0], [capital(`${violationWord(task)} added`), "warm", 1]];
  const net = (i) => number(ordered[i].regret.total[0], more), wide = ends[0] + ends[1];
  const build = () => ({
    traces: [
      ...kinds.map(([name, colour, k]) => ({
        type: "bar", orientation: "h", name, y: ordered.map((_, i) => i), x: parts.map((both, i) => cut(both[k], i)), marker: { color: variable(colour) },
        customdata: parts.map((both) => number(both[k], more, true)), hovertemplate: `${name} %{customdata}<extra></extra>`,
      })),
      { type: "scatter", mode: "text", y: ordered.map((_, i) => i), x: ordered.map((_, i) => Math.min(right[i], ends[0])), text: ordered.map((_, i) => `  ${off[i] ? "\u25b6 " : ""}${net(i)}`), textposition: "middle right", cliponaxis: false, hoverinfo: "skip", textfont: { color: variable("ink") } },
    ],
    layout: layout({
      barmode: "relative", bargap: 0.4, hovermode: "closest", margin: { l: 8, r: 12, t: 10, b: 8 },
      yaxis: { autorange: "reversed", showgrid: false, zeroline: false, tickvals: ordered.map((_, i) => i), ticktext: ordered.map((result) => plain(result.agent)) },
      xaxis: { range: [left.some((value) => value > 0) ? -1.05 * ends[1] : 0, ends[0] + 0.4 * wide], zeroline: true, zerolinewidth: 1.5, zerolinecolor: variable("soft"), title: axisTitle(unit || "points of reward") },
    }),
  });
  const span = (result, [, low, high], places) => (high > low ? `${number(low, places)} ${result.members ? "\u2194" : "to"} ${number(high, places)}` : "\u2013");
  const cell = (result, name, places) => (result.regret[name] ? [number(result.regret[name][0], places), h("span", { class: "of" }, span(result, result.regret[name], places))] : "\u2013");
  const [profit, penalty] = [words.metric[PROFIT], words.metric[PENALTY]];
  return [
    h("h2", {}, "How far from the best known?"),
    h("p", { class: "soft" }, `Regret: the best known run with the same seed minus the agent\u2019s, mean over the runs. The best known runs are by ${KNOWN_OF(task)}, with a mean ${lower(words.metric[SCORE].label)} of ${amountOf(task, SCORE, task.best_known.reward)}. Who made them may have known the whole season in advance, which no agent does that sees only observations. They are no bound: a better one may exist.${results.some(regretRuns) ? ` Only the first ${task.best_known.runs} runs have plans, and all regrets are over these.` : ""}`),
    betterNotes(results),
    chart(captionOf("Regret", `${unit || "points of reward"}, mean over the runs`), build, {
      height: 70 + 34 * ordered.length, says: ordered.map((result, i) => `${result.agent}: regret ${net(i)}, of it profit ${number(parts[i][0], more)} and violations ${number(parts[i][1], more)}`).join("; "),
      note: h("p", { class: "small soft" }, kinds.map(([name, colour]) => [h("span", { class: "key", style: { background: `var(--${colour})` }, "aria-hidden": "true" }), `${name}. `]),
        left.some((value, i) => value > 10 ** -more / 2) ? "What lies left of zero is better than in the best known run; the number is what remains. " : "", off.some(Boolean) ? "\u25b6: longer than the scale, its parts in proportion." : ""),
    }),
    h("details", { class: "data" }, h("summary", {}, "This figure as a table, with intervals"), plainTable("Regret to the best known runs", ["Agent", `Regret${unit ? `, ${unit}` : ""}`, `Profit given away, ${profit.unit}`, `${kinds[1][0]}${penalty.unit ? `, ${penalty.unit}` : ""}`],
      ordered.map((result) => [[swatch(result.agent), labelOf(result)], cell(result, "total", more), cell(result, "profit", profit.decimals), cell(result, "violations", penalty.unit ? penalty.decimals : penalty.decimals + 1)]))),
  ];
};

// The same of one agent, below its money.
const regretTile = (result, task) => {
  const found = regretOf(result);
  if (!found) return null;
  const words = wordsOf(task), { decimals, unit } = words.metric[SCORE], part = (name, metric) => withUnit(found[name][0], words.metric[metric].decimals, words.metric[metric].unit);
  return h("div", {}, h("dt", {}, "Regret to the best known"), h("dd", {}, number(found.total[0], decimals), unit ? h("small", {}, ` ${unit}`) : null,
    found.profit && found.violations ? h("small", { class: "of" }, [`profit ${part("profit", PROFIT)}`, `${violationWord(task)} ${part("violations", PENALTY)}`, regretRuns(result)].filter(Boolean).join(", ")) : null));
};
