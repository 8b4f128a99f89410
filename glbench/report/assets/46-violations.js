// What hangs on the price of violations: profit against violations, who is not beaten in both, and orders at other prices. The same for a task and a suite;
// a point has profit and violations, places at multiples of the price, and what is known of its order.

const priceOf = (point, factor) => point.at_prices.find(([one]) => one === factor);
const placeText = (place) => (place ? `${number(place[2], 2)} (rank ${place[1]})` : "\u2013");

// A chart that agents far away would flatten; they are named below it.
const scaleOf = (points, key, better) => {
  const [low, high] = barRange(points.map(({ [key]: value }) => ({ mean: value, low: value, high: value })), points.map((point) => point.agent), better), margin = 0.12 * (high - low) || 0.1;
  return [low - margin, high + margin];
};
const SHOWN_TURNS = 4;
const turnOf = ([one, other, factor]) => [h("b", {}, one), " and ", h("b", {}, other), ` at ${Number(factor.toPrecision(2))} times the price`];
const frontierLine = (points) => points.filter((point) => point.frontier).sort((a, b) => a.violations - b.violations || a.profit - b.profit);
const turnWords = (turns) => (turns.length ? ["These change places: ", ...turns.slice(0, SHOWN_TURNS).flatMap((turn, i) => [i ? "; " : "", ...turnOf(turn)]), turns.length > SHOWN_TURNS ? `; and ${turns.length - SHOWN_TURNS} more, below.` : "."]
  : ["No order of two agents with different ranks turns between half and double the price."]);

const priceChart = (points) => {
  const [lowest, highest] = scaleOf(points, "profit", "high"), [few, many] = scaleOf(points.filter(({ profit }) => profit >= lowest && profit <= highest), "violations", "low"), isInside = ({ profit, violations }) => profit >= lowest && profit <= highest && violations >= few && violations <= many;
  const inside = points.filter(isInside), outside = points.filter((point) => !isInside(point)), best = frontierLine(inside), [first] = [...inside].sort((a, b) => (b.profit - b.violations) - (a.profit - a.violations));
  const equal = first ? [few, many].map((violations) => first.profit - first.violations + violations) : [];
  const build = () => ({
    traces: [
      line([few, many], equal, variable("soft"), { line: { width: 1, dash: "dot" }, hoverinfo: "skip" }),
      line(best.map((point) => point.violations), best.map((point) => point.profit), variable("accent"), { line: { width: 1.5, shape: "hv" }, hoverinfo: "skip" }),
      ...inside.map((point) => ({
        type: "scatter", mode: "markers+text", x: [point.violations], y: [point.profit], name: plain(point.agent), text: [plain(point.agent)], textposition: "top center", textfont: { size: 10, color: variable("ink") }, cliponaxis: false,
        marker: { size: 9, symbol: symbolOf(point.agent), color: colourOf(point.agent) }, hovertemplate: `profit %{y:.2f}, violations %{x:.2f} EUR/m\u00b2`,
      })),
    ],
    layout: layout({ hovermode: "closest", margin: { l: 8, r: 40, t: 18, b: 8 }, xaxis: { range: [few, many], title: axisTitle("violations, EUR/m\u00b2") }, yaxis: { range: [lowest, highest], title: axisTitle("profit, EUR/m\u00b2") } }),
  });
  return chart(captionOf("Profit against what violations cost", "EUR/m\u00b2, means over the runs"), build, {
    height: 340, says: points.map((point) => `${point.agent}: profit ${number(point.profit, 2)}, violations ${number(point.violations, 2)}${point.frontier ? ", on the frontier" : ""}`).join("; "),
    note: h("p", { class: "small soft" }, "Up and left is better. Line: the frontier, agents that see observations and that no other such agent beats in both. Dotted: the same score as the best of the points, at the task\u2019s price; at double the price it falls twice as steeply to the left. ",
      outside.length ? `Off the scale: ${outside.map((point) => `${point.agent} (profit ${number(point.profit, 1)}, violations ${number(point.violations, 1)})`).join("; ")}.` : ""),
  });
};

const pricePart = (points, turns) => {
  if (points.length < 2) return null;
  const known = [0.5, 1, 2];
  return [
    h("h2", { id: "violations" }, "What hangs on the price of violations?"),
    h("p", {}, turnWords(turns)),
    h("p", { class: "soft" }, "The price of an hour outside the limits is set by the task, and growers may differ on it. Ranks at half and double the price come from the same runs; agents act as they were made for the task\u2019s price."),
    priceChart(points),
    h("details", { class: "data" }, h("summary", {}, "Ranks at other prices, as a table"), plainTable("Mean score, EUR/m\u00b2, and rank at multiples of the price of violations",
      ["Agent", "Profit", "Violations", ...known.map((factor) => `${factor} \u00d7 the price`), "Frontier", "P(reversed)"],
      points.map((point) => [[swatch(point.agent), breakable(point.agent)], number(point.profit, 2), number(point.violations, 2), ...known.map((factor) => placeText(priceOf(point, factor))), point.frontier ? "yes" : "\u2013", point.reversal === null ? "\u2013" : chance(point.reversal)])),
      turns.length > SHOWN_TURNS ? h("p", { class: "small" }, "All that change places: ", turns.flatMap((turn, i) => [i ? "; " : "", ...turnOf(turn)]), ".") : null),
  ];
};

// At prices that the reader chose another order holds, which the table of the page shows.
const violationsOf = (task, rows) => (pricesDiffer(task) ? null : pricePart(rows.filter((row) => row.rank !== null && row.result.at_prices).map(({ result }) => ({
  agent: result.agent, profit: estimate(result, PROFIT).mean, violations: estimate(result, PENALTY).mean, at_prices: result.at_prices, frontier: result.frontier, reversal: result.reversal,
})), task.turns));
const suiteViolations = (suite) => pricePart(suite.rows.filter((row) => row.at_prices && row.figures).map((row) => ({ ...row, profit: row.figures[PROFIT], violations: row.figures[PENALTY] })), suite.turns);
