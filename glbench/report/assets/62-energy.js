// A day of energy: where gas and power go in tasks with boiler, engine and buffer, on the mean day and by the hour.

const HEAT = "warm", POWER = "accent", GAS = "soft";
const BOILER = 1, ENGINE = 3, OWN = 0, BOUGHT = 7, SOLD = 2; // places in the palette

// What flows on the mean day [kWh/m²]: from, to, amount, and the kind that gives it its colour.
const energyFlows = (of) => {
  const made = of("heat") + of("engine_heat"), stored = made - of("heat_dumped") - of("heat_to_pipes") - of("heat_lost");
  const burnt = of("gas") - of("engine_gas"), flue = "Lost in flue gas", buffer = "Buffer";
  return [
    ["Gas", "Boiler", burnt, GAS], ["Gas", "Engine", of("engine_gas"), GAS],
    ["Boiler", buffer, of("heat"), HEAT], ["Boiler", flue, burnt - of("heat"), GAS],
    ["Engine", buffer, of("engine_heat"), HEAT], ["Engine", flue, of("engine_gas") - of("engine_heat") - of("electricity_made"), GAS],
    ["Engine", "Lamps", of("electricity_made") - of("electricity_sold"), POWER], ["Engine", "Sold", of("electricity_sold"), POWER], ["Bought", "Lamps", of("electricity_bought"), POWER],
    [buffer, "Pipes", of("heat_to_pipes"), HEAT], [buffer, "Lost by the buffer", of("heat_lost"), HEAT], [buffer, "Let off: buffer full", of("heat_dumped"), HEAT],
    stored > 0 ? [buffer, "Left at the end", stored, HEAT] : ["There at the start", buffer, -stored, HEAT],
  ];
};

const energyPart = (profile, task) => {
  if (!profile.energy) return null;
  const hourly = Object.fromEntries(Object.entries(profile.energy.columns).map(([name, packed]) => [name, unpack(packed)]));
  const of = (name) => sum(hourly[name].filter((value) => value !== null));
  const burnt = of("gas"), made = of("electricity_made"), shareOf = (part, whole) => `${number(whole > 0 ? (100 * part) / whole : 0, 0)}\u00a0%`;
  const all = energyFlows(of), most = Math.max(...all.map(([, , amount]) => amount)), flows = all.filter(([, , amount]) => amount > 0.003 * most);
  if (!flows.length) return null;
  const unit = "kWh/m\u00b2 a day", grams = (value) => `${number(1000 * value, 1)}\u00a0g/m\u00b2`, words = flows.map(([from, to, amount]) => `${from} to ${lower(to)} ${number(amount, 2)}`);
  const nodes = [...new Set(flows.flatMap(([from, to]) => [from, to]))], through = (node) => Math.max(...[0, 1].map((end) => sum(flows.filter((flow) => flow[end] === node).map(([, , amount]) => amount))));
  const sankey = () => ({
    traces: [{
      type: "sankey", arrangement: "snap", valueformat: ",.2f", valuesuffix: " kWh/m\u00b2",
      node: { label: nodes.map((node) => `${node} ${number(through(node), 2)}`), color: nodes.map(() => variable("soft")), pad: 22, thickness: 12, line: { width: 0 }, hovertemplate: "%{label}<extra></extra>" },
      link: {
        source: flows.map(([from]) => nodes.indexOf(from)), target: flows.map(([, to]) => nodes.indexOf(to)), value: flows.map(([, , amount]) => amount),
        color: flows.map(([, , , kind]) => faded(variable(kind), kind === GAS ? 0.25 : 0.4)), hovertemplate: "%{source.label} \u2192 %{target.label}: %{value}<extra></extra>",
      },
      textfont: { color: variable("ink"), size: 12 },
    }],
    layout: layout({ margin: { l: 4, r: 4, t: 12, b: 12 }, hovermode: "closest" }),
  });
  const hours = Array.from({ length: 24 }, (_, hour) => hour + 0.5), bars = (y, label, ink) => ({ type: "bar", name: label, x: hours, y, marker: { color: colourAt(ink), opacity: 0.8 }, hovertemplate: "%{y:,.3f}" });
  const over = (y, label, colour) => line(hours, y, colour, { name: label, hovertemplate: "%{y:,.3f}" });
  const look = (yaxis = {}) => layout({ barmode: "stack", bargap: 0.15, showlegend: true, legend: { orientation: "h", traceorder: "normal", y: 1.02, yanchor: "bottom", x: 0, font: { color: variable("ink") } }, margin: { l: 8, r: 10, t: 34, b: 8 }, xaxis: HOUR_AXIS, yaxis: { zeroline: true, zerolinecolor: variable("soft"), ...yaxis } });
  const figure = (label, its, traces, yaxis) => chart(captionOf(label, its), () => ({ traces: traces(), layout: look({ title: axisTitle(its.split(" ")[0]), ...yaxis }) }), { height: 230, says: `${label} by hour of the day, mean over days and runs.` });
  const own = hourly.electricity_made.map((made, hour) => (made === null ? null : made - hourly.electricity_sold[hour]));
  const prices = Object.entries(profile.energy.prices).map(([money, packed], i) => ({ label: wordsOf(task).items.find((item) => item.money === money)?.label ?? money, values: unpack(packed), ink: SOLD + i }));
  return h("section", { id: "energy" },
    h("h2", {}, "A day of energy"),
    h("p", { class: "soft" }, `The mean day, over all days and runs; hours are ${hoursOf(task)}. The boiler burns ${shareOf(burnt - of("engine_gas"), burnt)} of the gas and the engine ${shareOf(of("engine_gas"), burnt)}. The engine makes ${withUnit(made, 2, "kWh/m\u00b2")} of power a day, of which ${shareOf(of("electricity_sold"), made)} is sold; ${withUnit(of("electricity_bought"), 2, "kWh/m\u00b2")} is bought. Of the CO\u2082 in the gas, ${grams(of("co2_made"))} a day, ${grams(of("co2_from_flue"))} were dosed; ${grams(of("co2_bought"))} were bought. What buffer, engine and prices earned: `, h("code", {}, "glbench episodes dispatch RESULT.json"), "."),
    chart(captionOf("Gas, heat and power", unit), sankey, { height: 330, says: words.join("; ") }),
    h("details", { class: "data" }, h("summary", {}, "This figure as a table"), plainTable("Flows of energy on the mean day", ["", unit], flows.map(([from, to, amount]) => [`${from} \u2192 ${lower(to)}`, number(amount, 3)]))),
    h("div", { class: "grid two" },
      figure("Heat made, and heat to the pipes", "kWh/m\u00b2 an hour", () => [bars(hourly.heat, "boiler", BOILER), bars(hourly.engine_heat, "engine", ENGINE), over(hourly.heat_to_pipes, "to the pipes", variable("ink"))]),
      figure("Heat in the buffer", "kWh/m\u00b2 at the end of the hour", () => [{ ...over(hourly.stored, "stored", colourAt(BOILER)), x: hours.map((hour) => hour + 0.5), fill: "tozeroy", fillcolor: faded(colourAt(BOILER), 0.18) }], { rangemode: "tozero" }),
      figure("Power: made for the lamps, bought for them, and sold", "kWh/m\u00b2 an hour", () => [bars(own, "own", OWN), bars(hourly.electricity_bought, "bought", BOUGHT), bars(hourly.electricity_sold, "sold", SOLD)]),
      prices.length ? figure("Prices that change, where something was traded", `EUR/kWh${pricesDiffer(task) ? " at the task\u2019s prices" : ""}`, () => prices.map(({ label, values, ink }) => line(hours, values, colourAt(ink), { name: plain(label), mode: "lines+markers", line: { shape: "hvh" }, hovertemplate: "%{y:,.4f}" })), { rangemode: "tozero" }) : null));
};
