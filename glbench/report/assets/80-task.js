// Tasks: the list, and one in words with its limits, prices, weather and versions.

const tasksPage = () => {
  const standings = new Map(D.tasks.map((task) => [task, standing(task)])), clear = [...standings.values()].filter(({ first, tied, next }) => first && next && !tied.length).length;
  return { title: "Tasks", content: [
    h("h1", {}, "Tasks"),
    h("p", { class: "story" }, `Of ${plural(D.tasks.length, "task")} with results, ${clear} ${clear === 1 ? "has" : "have"} one agent in the lead that is told apart from every other that sees no more than observations; on the rest the lead is shared, or only one agent is ranked.`),
    h("p", { class: "soft" }, "A task fixes everything that decides a result: weather, greenhouse, crop, what is uncertain, what an agent sees and does, limits, prices and seeds."),
    taskGroups().map(({ title, members }) => [h("h2", {}, title), plainTable(`${title}: ${plural(members.length, "task")} with results`, ["Task", ...(members.some((task) => task.delta !== undefined) ? ["Delta"] : []), "Results", "Leads", "Its score or reward"], members.map((task) => {
      const { first, tied } = standings.get(task), { decimals, unit } = wordsOf(task).metric[task.metric];
      return [[h("a", { href: link("task", task.short) }, task.short), ": ", h("span", { class: "of" }, task.title)], ...(members.some((one) => one.delta !== undefined) ? [task.delta === undefined ? "\u2013" : `${task.delta}\u00a0%`] : []), number(resultsOf(task.id).length, 0),
        first ? [labelOf(first.result), tied.length ? h("span", { class: "of" }, `not told apart: ${namesOf(tied)}`) : null] : "\u2013", first ? withUnit(estimate(first.result, task.metric).mean, decimals, unit) : "\u2013"];
    }))]),
  ] };
};

const taskPage = (short) => {
  const task = BY_SHORT[short];
  if (!task) return missingPage(`There are no results of a task \u201c${short}\u201d here.`);
  return {
    title: taskName(task),
    content: [
      h("h1", {}, taskName(task)),
      h("p", { class: "story" }, leadWords(task)),
      h("p", { class: "soft" }, task.description || "A task of somebody\u2019s own."),
      h("div", { class: "fields" }, taskField(task.short, (value) => go("task", value)), h("a", { class: "small", href: link("", task.short) }, "Its leaderboard")),
      task.words ? definition(task) : h("div", { class: "missing" }, "The definition of this task is not stored with its results: it is in the file that they were made with."),
      task.weather ? weatherPart(task) : task.words ? h("div", { class: "missing" }, h("b", {}, "Its weather is not stored with these results. "), "Evaluate an agent again, or run ", h("code", {}, "glbench report --complete"), ".") : null,
      h("h2", {}, "Identity"),
      h("p", {}, h("code", {}, task.id), " ", task.published ? tag("published", "ok") : tag("not published")),
      h("p", { class: "small" }, "Digest ", h("code", {}, task.digest)),
      task.versions?.length ? plainTable("Published versions. A published task never changes: a change is a new version, and the old one stays.", ["Version", "Digest", "Model"], task.versions.map((version) => [version.id, h("code", {}, version.digest.slice(0, 16)), version.model])) : null,
    ],
  };
};

// In growers’ words; below, in a fold, as the task file has it.
const definition = (task) => [
  h("section", { id: "definition" }, definitionParts(task.words)),
  h("details", { class: "data", id: "keys" }, h("summary", {}, "For programmers: the definition with its keys, as ", h("code", {}, `glbench tasks show ${task.short}`), " prints it"), h("div", { class: "small" }, definitionParts(task.keys))),
];
const definitionParts = (parts) => [
  h("div", { class: "columns" }, parts.filter((part) => part.lines.length).map((part) => h("section", {}, h("h3", {}, part.heading), part.lines.map((words) => h("p", {}, words))))),
  parts.filter((part) => part.rows.length).map((part) => h("details", { class: "data", open: part.rows.length < 12 }, h("summary", {}, part.heading),
    plainTable(part.heading, part.columns, part.rows, part.columns.map((_, i) => i).filter((i) => !part.right.includes(part.columns[i]))))),
];

const weatherPart = (task) => later(700, async () => {
  const weather = await block(task.weather), { series, charts } = wordsOf(task), ink = () => variable("accent");
  const x = Array.from({ length: task.days }, (_, day) => dayOf(task.start, day, SHORT_DATE)), ticks = x.filter((_, day) => day % Math.max(1, Math.ceil(task.days / 4)) === 0);
  const season = (name) => {
    const words = series[name], rows = unpack(weather.season.columns[name]), summed = Boolean(words.daily), factor = words.daily_factor ?? 1, [average, low, high] = scaled(rows, factor);
    const decimals = words.daily_decimals ?? words.decimals;
    return chart(captionOf(words.label, words.daily ?? `${words.unit}, mean and range of the day`), () => ({
      traces: summed
        ? [{ type: "bar", x, y: average, marker: { color: colourAt(3), opacity: 0.85 }, hovertemplate: `%{y:,.${decimals}f}<extra></extra>` }]
        : [band(x, low, high, ink(), 0.18), line(x, average, ink(), { name: "mean", hovertemplate: `%{y:,.${decimals}f}<extra></extra>` })],
      layout: layout({ xaxis: { title: DAY_TITLE, tickvals: ticks, tickangle: 0 }, yaxis: { title: axisTitle(words.daily ?? words.unit) }, bargap: 0.2, shapes: words.unit === "\u00b0C" ? [{ type: "line", xref: "paper", x0: 0, x1: 1, y0: 0, y1: 0, line: { color: variable("soft"), width: 1, dash: "dot" } }] : [] }),
    }), { height: 200, says: `${words.label} by day: ${number(Math.min(...average), decimals)} to ${number(Math.max(...average), decimals)}, mean ${number(mean(average), decimals)}.` });
  };
  const day = (name) => dayChart(task, name, [{ agent: null, packed: weather.day[name] }], weather.slot_seconds);
  const [warmth, light] = charts.weather, temperatures = unpack(weather.season.columns[warmth]), sun = scaled(unpack(weather.season.columns[light]), series[light].daily_factor)[0], frost = temperatures[1].filter((value) => value < 0).length;
  return [
    h("h2", {}, "Weather at a glance"),
    h("p", {}, `Mean temperature ${withUnit(mean(temperatures[0]), 1, "\u00b0C")}, between ${withUnit(Math.min(...temperatures[1]), 1, "\u00b0C")} and ${withUnit(Math.max(...temperatures[2]), 1, "\u00b0C")}; ${weather.runs > 1 ? `on ${plural(frost, "day")} of ${task.days} at least one of the ${weather.runs} runs had frost` : `frost on ${plural(frost, "day")}`}; ${number(mean(sun), 1)} MJ/m\u00b2 of sun on the mean day, ${weather.runs > 1 ? "mean over the runs: " : ""}${number(Math.min(...sun), 1)} MJ/m\u00b2 on the darkest and ${number(Math.max(...sun), 1)} MJ/m\u00b2 on the brightest${weather.runs > 1 ? " day; single days of single runs can be darker and brighter" : ""}.`,
      task.start ? "" : " Runs start on different days: day 1 is the first day of each."),
    h("div", { class: "grid" }, charts.weather.map(season)),
    h("h3", {}, "By hour of the day: median, 50 % and 90 % bands over the days"),
    h("p", { class: "soft" }, `Hours are ${hoursOf(task)}.`),
    h("div", { class: "grid" }, charts.weather.map(day)),
  ];
});

const guidePage = () => ({
  title: "Guide",
  content: [
    h("h1", {}, "How to read this page"),
    h("p", { class: "lead" }, "Every number in a grower\u2019s words. All areas are m\u00b2 of greenhouse floor; sums run over the whole period of a task and are means over its runs."),
    h("h2", {}, "Numbers"),
    h("dl", { class: "words" }, [...new Map(WORDS.flatMap((words) => words.metrics).map((metric) => [`${metric.label} ${metric.explanation}`, metric])).values()].filter((metric) => !["earned", "paid", "unknown"].includes(metric.kind)).map((metric) => [h("dt", {}, metric.label, metric.unit ? h("span", {}, ` ${metric.unit}`) : null), h("dd", {}, metric.explanation)])),
    h("h2", {}, "Words"),
    h("dl", { class: "words" }, D.other_words.map(([word, meaning]) => [h("dt", {}, word), h("dd", {}, meaning)])),
    h("h2", {}, "What not to read out of it"),
    h("p", {}, `A model is no greenhouse: it knows no pests, no labour and no broken pump. ${[...new Set(WORDS.map((words) => words.caution).filter(Boolean))].map((words) => `${words} `).join("")}Where nothing is random, all runs are alike and there is no interval; small roundings grow in a closed loop, so ${D.tasks.every((task) => inMoney(task, SCORE)) ? "small differences" : "differences of a few units of reward"} mean nothing there.`),
    h("p", {}, "An interval covers the draws of a task\u2019s season, or of seasons of the same years, for one training. How an agent does in another year, or how another training of it would do, it cannot say: where several trainings were made, their range shows how much that matters."),
  ],
});
