// Two agents on one task: which earns more, by item and by hour of the day.

const comparePage = (first, second, short) => {
  const task = BY_SHORT[short] ?? TASKS[D.start], here = resultsOf(task.id).map((result) => result.agent);
  if (here.length < 2) return { title: "Compare", content: [h("h1", {}, "Compare two agents"), h("div", { class: "fields" }, taskField(task.short, (value) => go("compare", first ?? here[0], second ?? here[0], value))), h("p", {}, "Only one agent has results on this task.")] };
  const a = here.includes(first) ? first : ranked(task.id)[0].result.agent;
  const b = here.includes(second) && second !== a ? second : ranked(task.id).map((row) => row.result.agent).find((name) => name !== a);
  const [one, two] = [resultOf(task.id, a), resultOf(task.id, b)];
  return {
    title: `${a} and ${b}`,
    content: [
      h("h1", {}, "Where does one earn more?"),
      h("div", { class: "fields" }, agentField("Agent A", a, (value) => go("compare", value, value === b ? a : b, task.short), here, "choose-a"),
        agentField("Agent B", b, (value) => go("compare", value === a ? b : a, value, task.short), here, "choose-b"), taskField(task.short, (value) => go("compare", a, b, value))),
      h("p", { class: "story" }, verdict(one, two, task)),
      priceField(task, (focus) => show(focus)),
      [one, two].filter((result) => result.members).map((result) => h("p", { class: "note" }, `${result.agent} is the mean of ${plural(result.trainings, "training")}. By hour of the day and on typical days it is the training with seed ${trainingsOf(result)[0].training_seed}.`)),
      sharedWords(one, two),
      byItem(one, two, task),
      one.profile && two.profile ? byHour(one, two, task) : [one, two].filter((result) => !result.profile).map((result) => [h("p", {}, h("b", {}, result.agent), ":"), noProfile(result, task)]),
    ],
  };
};

// Places of the seeds that both have, in the runs of each.
const sharedRuns = (one, two) => {
  const place = new Map(two.seeds.map((seed, i) => [seed, i]));
  return one.seeds.map((seed, i) => [i, place.get(seed)]).filter(([, j]) => j !== undefined);
};
const sameSeeds = (one, two) => one.seeds.length === two.seeds.length && sharedRuns(one, two).length === one.seeds.length;

// Both means and their difference over the seeds that both have, with the interval of the difference; without shared seeds over the runs of each.
const difference = (one, two, metric) => {
  const [x, y] = [valuesOf(one, metric), valuesOf(two, metric)], runs = sharedRuns(one, two);
  const of = (values, side) => (values ? mean(runs.length ? runs.map((pair) => values[pair[side]]) : values) : null);
  const [first, second] = [of(x, 0), of(y, 1)];
  if (!x || !y) return { ...UNKNOWN, first, second };
  if (!runs.length) return { ...UNKNOWN, first, second, mean: first - second };
  const sides = [one, two].map((result, side) => valuesByTraining(result, metric).map((values) => runs.map((pair) => values[pair[side]])));
  const [low, high] = intervalOf(estimateMean(sides, [isFixed(one), isFixed(two)]));
  return { first, second, mean: first - second, low, high };
};

// Over which runs the two are compared, where they do not have the same ones.
const sharedWords = (one, two) => {
  const runs = sharedRuns(one, two).length, own = `${one.agent} has ${plural(one.seeds.length, "run")}, ${two.agent} has ${two.seeds.length}`;
  if (sameSeeds(one, two)) return null;
  return h("p", { class: "note" }, runs ? `${own}. Everything here is over the ${plural(runs, "seed")} that they share, so means differ from those on the leaderboard.`
    : `${own}, and they share no seed: each mean is over an agent\u2019s own runs, so part of every difference comes from other draws.`);
};

const verdict = (one, two, task) => {
  const gap = (name) => difference(one, two, name), profit = gap(PROFIT), penalty = gap(PENALTY), reward = gap(task.metric), runs = sharedRuns(one, two).length;
  const rows = ranked(task.id), [a, b] = [one, two].map((result) => rows.find((row) => row.result === result)), clear = apart(a, b, task), { label, decimals, unit } = wordsOf(task).metric[task.metric];
  const differ = (figure, metric) => `differ by ${amountOf(task, metric, figure.mean)}${betweenWords(figure, wordsOf(task).metric[metric].decimals)}`, amounts = amountWords(one, two, task), notes = [one, two].filter((result) => trainingNote(result)).map((result) => `${result.agent} is ${result.members ? "the " : ""}${trainingNote(result)}`);
  return [
    clear ? [h("b", {}, one.agent), ` has a ${lower(label)} `, h("b", { class: reward.mean >= 0 ? "gain" : "loss" }, withUnit(Math.abs(reward.mean), decimals, unit)), ` ${reward.mean >= 0 ? "higher" : "lower"} than `, h("b", {}, two.agent), `${betweenWords(reward, decimals)}: the two are told apart`]
      : [h("b", {}, one.agent), " and ", h("b", {}, two.agent), runs ? ` cannot be told apart: their ${lower(label)}s ${differ(reward, task.metric)}` : ` share no seed, so nothing tells chance from a difference: their ${lower(label)}s ${differ(reward, task.metric)}`],
    `, over ${runs ? plural(runs, "shared seed") : "each agent\u2019s own runs"} of ${task.short}. `,
    isClear(profit) && Math.abs(profit.mean) >= 5e-3 ? `${one.agent} earns ${withUnit(Math.abs(profit.mean), 2, "EUR/m\u00b2")} ${profit.mean >= 0 ? "more than" : "less than"} ${two.agent}${betweenWords(profit, 2)}` : `Their profits ${differ(profit, PROFIT)}, which may be chance`,
    isClear(penalty) ? `; it has ${moreViolations(task, penalty.mean)}` : `; the difference of their ${violationWord(task)} may be chance`,
    amounts.length ? `. It ${sentence(amounts)}.` : ".", notes.length ? ` ${sentence(notes)}.` : "",
  ];
};

const byItem = (one, two, task) => {
  const words = wordsOf(task), METRICS = words.metric, items = [...words.items.map((item) => [item.money, item.sign]), [PROFIT, 1]];
  const gaps = items.map(([name, sign]) => { const d = difference(one, two, name); return { name, label: name === PROFIT ? words.series[PROFIT].label : METRICS[name].label, value: sign * d.mean, low: sign > 0 ? d.low : -d.high, high: sign > 0 ? d.high : -d.low }; });
  const ends = [Math.min(0, ...gaps.map((gap) => gap.value)), Math.max(0, ...gaps.map((gap) => gap.value))], room = 0.45 * (ends[1] - ends[0] || 1);
  const build = () => ({
    traces: [{
      type: "bar", orientation: "h", y: gaps.map((gap) => gap.label), x: gaps.map((gap) => gap.value), text: gaps.map((gap) => ` ${number(gap.value, 2, true)} `), textposition: "outside", cliponaxis: false, hoverinfo: "skip",
      marker: { color: gaps.map((gap) => variable(gap.value >= 0 ? "gain" : "loss")), opacity: gaps.map((gap) => (gap.name === PROFIT ? 1 : 0.75)) }, textfont: { color: variable("ink") },
    }],
    layout: layout({ hovermode: false, bargap: 0.4, yaxis: { autorange: "reversed", showgrid: false, tickmode: "linear", dtick: 1 }, xaxis: { range: [ends[0] - room, ends[1] + room], zeroline: true, zerolinecolor: variable("soft"), zerolinewidth: 1.5, title: axisTitle("EUR/m\u00b2, A minus B") } }),
  });
  const runs = sharedRuns(one, two).length, over = runs ? `means over ${plural(runs, "shared seed")}` : "means over each agent\u2019s own runs";
  const rows = [...items.map(([name]) => name), ...words.columns.map((metric) => metric.name).filter((name) => name !== PROFIT), ...words.ofKind("unknown").map((metric) => metric.name)].map((name) => {
    const metric = METRICS[name], d = difference(one, two, name), unit = metric.unit, cost = metric.kind === "paid";
    return [[`${cost ? "Cost of " : ""}${cost ? lower(metric.label) : metric.label}`, unit ? h("span", { class: "soft" }, ` ${unit}`) : null], number(d.first, metric.decimals), number(d.second, metric.decimals),
      number(d.mean, metric.decimals, true), number(d.low, metric.decimals, true) !== number(d.high, metric.decimals, true) ? `${number(d.low, metric.decimals, true)} to ${number(d.high, metric.decimals, true)}` : "\u2013"];
  });
  return [
    h("h2", {}, "By item"),
    h("div", { class: "grid two" },
      chart(captionOf(`${one.agent} minus ${two.agent}`, "EUR/m\u00b2; to the right, A is better"), build, { height: 460, says: gaps.map((gap) => `${gap.label} ${number(gap.value, 2, true)}`).join(", ") }),
      plainTable(`A is ${one.agent}, B is ${two.agent}; ${over}, differences with 95 % intervals: ${wordsOf(task).draws}, trainings where there are several (\u2013: narrower than the digits shown)`, ["", "A", "B", "A \u2212 B", "95 % interval"], rows)),
  ];
};

const byHour = (one, two, task) => later(1500, async () => {
  const [x, y] = await Promise.all([block(one.profile), block(two.profile)]), prices = pricesOf(task);
  const perRun = (profile, name) => unpack(profile.hours[name]);
  const shared = sharedRuns(one, two), pairs = shared.length ? shared : null;
  const gap = (name, factorAt) => {
    const [p, q] = [perRun(x, name), perRun(y, name)];
    return p.map((row, hour) => (pairs ? pairs.map(([i, j]) => factorAt(hour) * (row[i] - q[hour][j])) : [factorAt(hour) * (mean(row) - mean(q[hour]))]));
  };
  // A price that changes by the hour is that of its hour; one that changes otherwise is what A paid on average.
  const paid = (name) => sum(pairs ? pairs.map(([i]) => one.values[name][i]) : one.values[name]), priceAt = (item) => {
    const { money, amount, table } = item;
    if (!table) return () => prices[money];
    const hourly = task.hourly_prices[money], average = paid(money) / (paid(amount) || 1);
    return (hour) => prices[money] * (prices[flatOf(money)] ? meanPrice(task, item) : hourly.length ? hourly[hour] : average) + prices[addedTo(money)];
  };
  const { items } = wordsOf(task), shown = items.filter(({ column }) => x.hours[column] && y.hours[column]), atEnd = items.filter((item) => !shown.includes(item)), averaged = shown.filter(({ money, table }) => table && !task.hourly_prices[money].length);
  const parts = shown.map((item) => ({ label: item.label, runs: gap(item.column, (hour) => item.sign * priceAt(item)(hour)), ink: item.colour }));
  const penalty = gap(PENALTY, () => -1), profit = penalty.map((row, hour) => row.map((_, run) => sum(parts.map((part) => part.runs[hour][run]))));
  const spread = profit.map((values) => [mean(values), ...(values.length > 1 ? interval(values) : [mean(values), mean(values)])]);
  const hours = Array.from({ length: 24 }, (_, hour) => hour + 0.5);
  const ranges = sentence(stretches(spread.map(([value, low]) => low > 0 && value > 0.005 * Math.max(...spread.map(([v]) => Math.abs(v))))));
  const money = () => ({
    traces: [
      ...parts.map((part) => ({ type: "bar", name: part.label, x: hours, y: part.runs.map(mean), marker: { color: colourAt(part.ink), opacity: 0.8 }, hovertemplate: "%{y:+,.3f}" })),
      line(hours, spread.map(([value]) => value), variable("ink"), { name: wordsOf(task).series[PROFIT].label, mode: "lines+markers", marker: { size: 5 }, hovertemplate: "%{y:+,.3f}", error_y: { type: "data", symmetric: false, array: spread.map(([m, , high]) => high - m), arrayminus: spread.map(([m, low]) => m - low), thickness: 1, width: 2, color: variable("ink") } }),
    ],
    layout: layout({ barmode: "relative", bargap: 0.15, showlegend: true, legend: { orientation: "h", y: 1.02, yanchor: "bottom", x: 0, font: { color: variable("ink") } }, margin: { l: 8, r: 10, t: 34, b: 8 }, xaxis: HOUR_AXIS, yaxis: { title: axisTitle("EUR/m\u00b2, A minus B"), zeroline: true, zerolinecolor: variable("soft"), zerolinewidth: 1.5 } }),
  });
  const spared = wordsOf(task).metric[PENALTY].label;
  const limits = () => ({
    traces: [{ type: "bar", x: hours, y: penalty.map(mean), marker: { color: penalty.map((values) => variable(mean(values) >= 0 ? "gain" : "loss")) }, hovertemplate: `%{y:+,.${inMoney(task, PENALTY) ? 3 : 2}f}<extra></extra>` }],
    layout: layout({ bargap: 0.15, xaxis: HOUR_AXIS, yaxis: { title: axisTitle(inMoney(task, PENALTY) ? `${wordsOf(task).metric[PENALTY].unit}, spared` : "spared"), zeroline: true, zerolinecolor: variable("soft"), zerolinewidth: 1.5 } }),
  });
  return [
    h("h2", { id: "hours" }, "By hour of the day"),
    h("p", { class: "soft" }, ranges ? `${one.agent} earns more than ${two.agent} ${ranges}, beyond chance` : `${one.agent} earns more than ${two.agent}, beyond chance, in no hour of the day`, `. Sums over the whole season, A minus B, ${pairs ? "mean over the shared seeds" : "means over each agent\u2019s own runs"}; hours are ${hoursOf(task)}.`, atEnd.length ? ` Not by the hour: ${sentence(atEnd.map((item) => lower(item.label)))}.` : "", averaged.length ? ` Its price changes with the calendar, so at its mean price: ${sentence(averaged.map((item) => lower(item.label)))}.` : ""),
    chart(captionOf("Profit, A minus B", "EUR/m\u00b2; above the line, A is better"), money, { height: 330, says: `Profit by hour of the day, ${one.agent} minus ${two.agent}: ${spread.map(([value], hour) => `${hour} h ${number(value, 2, true)}`).join(", ")}` }),
    h("div", { style: { height: "14px" } }),
    chart(captionOf(`${spared} spared, A against B`, `${inMoney(task, PENALTY) ? `${wordsOf(task).metric[PENALTY].unit}; ` : ""}above the line, A keeps the limits better`), limits, { height: 200, says: `${spared} spared by hour: ${penalty.map((values, hour) => `${hour} h ${number(mean(values), inMoney(task, PENALTY) ? 3 : 1, true)}`).join(", ")}` }),
    h("h2", {}, "Their typical days"),
    ...(sameSeeds(one, two) ? typicalDays(one, two, x, y, task) : [h("p", { class: "soft" }, "Not drawn side by side: a typical day is that of all runs of a result, and these two results have different runs, with other draws. Each is on its agent\u2019s page: ",
      h("a", { href: link("agent", one.agent, task.short) }, one.agent), ", ", h("a", { href: link("agent", two.agent, task.short) }, two.agent), ".")]),
  ];
});

const typicalDays = (one, two, x, y, task) => {
  const { charts, controls } = wordsOf(task);
  return [
    h("p", { class: "soft" }, "Median over all days and runs, with 50 % bands; dotted lines are limits."),
    h("ul", { class: "legend", "aria-label": "Colours" }, [one, two].map((result) => h("li", {}, swatch(result.agent), result.agent, "\u2003"))),
    h("div", { class: "grid" }, [...charts.climate, ...controls, ...charts.compared].filter((name) => x.day.columns[name] && y.day.columns[name]).map((name) => dayChart(task, name, [[one, x], [two, y]].map(([result, profile]) => ({ agent: result.agent, packed: profile.day.columns[name] })), x.day.slot_seconds))),
  ];
};

// Hours for which something holds, in words: "from 06:00 to 11:00".
const stretches = (holds) => {
  const found = [];
  for (let hour = 0; hour < 24; hour++) if (holds[hour]) {
    let end = hour;
    while (end < 24 && holds[end]) end++;
    found.push(end - hour === 24 ? "at every hour" : `from ${clockHour(hour)} to ${clockHour(end)}`);
    hour = end;
  }
  return found;
};
