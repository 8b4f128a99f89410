// One agent on one task: what it earned and where, a typical day, the season, broken limits, its worst run.

const agentsPage = () => {
  const rows = ENTRIES.map((agent) => ({ agent, results: D.results.filter((result) => result.agent === agent.name) })), leads = new Map();
  for (const task of D.tasks) {
    const { first, usual, tied } = standing(task);
    if (first && usual) for (const row of [first, ...tied]) leads.set(row.result.agent, (leads.get(row.result.agent) ?? 0) + 1);
  }
  const [most] = [...leads].sort((a, b) => b[1] - a[1]), privileged = rows.filter(({ results }) => results.every((result) => result.privileged)).map(({ agent }) => agent.name);
  return {
    title: "Agents",
    content: [
      h("h1", {}, "Agents"),
      h("p", { class: "story" }, most ? [h("b", {}, most[0]), ` leads most often: alone, or not told apart from the agent with the highest mean, on ${most[1]} of the ${plural(rows.find(({ agent }) => agent.name === most[0]).results.length, "task")} that it was evaluated on. Only agents that see no more than observations are counted${privileged.length ? `; ${sentence(privileged)} ${privileged.length === 1 ? "is" : "are"} privileged` : ""}.`] : "No result here is ranked."),
      h("p", { class: "soft" }, "Everything that has results here. Open one for its money, its typical day, its season and its worst run."),
      plainTable("All agents: what they see and on how many tasks they were evaluated", ["Agent", "Sees", "Source", "Trainings", "Tasks", "Leads, alone or shared"], rows.map(({ agent, results }) => [
        [swatch(agent.name), h("a", { href: link("agent", agent.name) }, agent.name), " ", tag(agent.kind)],
        agent.information, [...new Set(results.map(sourceOf))].join("; "),
        trainingsWords({ trainings: [Math.min(...results.map((result) => result.trainings || 1)), Math.max(...results.map((result) => result.trainings || 1))] }).replace(/ trainings/, "") || "1",
        number(results.length, 0), number(leads.get(agent.name) ?? 0, 0),
      ]), [0, 1]),
    ],
  };
};

const agentPage = (name, short) => {
  if (!Object.hasOwn(AGENTS, name)) return missingPage(`No agent in these results is named \u201c${name}\u201d.`);
  const results = D.results.filter((result) => result.agent === name);
  const result = results.find((one) => TASKS[one.task].short === short) ?? results.find((one) => one.task === D.start) ?? results[0];
  const task = TASKS[result.task], others = resultsOf(task.id).filter((one) => one.agent !== name && one.agent !== result.member_of);
  const first = result.members ? trainingsOf(result)[0] : result;
  return {
    title: name,
    content: [
      h("h1", {}, swatch(name), labelOf(result), result.privileged ? [" ", tag("privileged")] : null, [" ", tag(sourceOf(result))], result.reproduced ? [" ", tag("\u2713 reproduced", "ok")] : null),
      result.member_of ? h("p", { class: "small" }, `The training of ${result.member_of} with seed ${result.training_seed}. `, h("a", { href: link("agent", result.member_of, task.short) }, "All trainings")) : null,
      h("p", { class: "story" }, story(result, task)),
      h("p", { class: "small soft" }, `Sees: ${result.sees.replace(/^privileged: /, "")}. Trained on: ${result.trained_on}${result.trained_on === "unknown" ? "" : ", as its card states"}.`),
      result.saw_scored ? h("p", { class: "note" }, `\u00a7 ${name} ${result.saw_scored}, as its card states.`) : null,
      cardPart(result),
      h("div", { class: "fields" }, agentField("Agent", name, (value) => go("agent", value, task.short), [...ENTRIES.map((agent) => agent.name), ...(result.member_of ? [name] : [])], "choose-agent"),
        taskField(task.short, (value) => go("agent", name, value), results.map((one) => TASKS[one.task])),
        others.length && !result.member_of ? h("a", { class: "small", href: link("compare", name, others[0].agent, task.short) }, "Compare it with another agent") : null),
      failures(result),
      priceField(task, (focus) => show(focus)),
      trainingsPart(result, task),
      earned(result, task),
      result.members ? h("p", { class: "note" }, `Days, season, calendar and worst run below are those of the training with the lowest seed, ${first.training_seed}.`) : null,
      first.profile ? profileParts(first, task) : noProfile(first, task),
      settingsPart(first),
      provenance(first),
    ],
  };
};

// Each training of an entry, in the order of the seeds.
const trainingsPart = (result, task) => {
  const { headlines, sold, metric: METRICS } = wordsOf(task), told = [...headlines, ...sold.map((item) => item.amount)];
  return result.members ? [
    h("h2", {}, "Its trainings"),
    h("p", { class: "soft" }, "The same recipe, trained with other seeds. What stands above and in tables is their mean; the range says how much the seed of a training matters, as far as these few can say."),
    plainTable(`${plural(result.trainings, "training")} of ${result.agent}: mean over the runs, with 95 % intervals over the draws`, ["Training", ...told.map((name) => METRICS[name].label)], trainingsOf(result).map((one) => [
      h("a", { href: link("agent", one.agent, task.short) }, `seed ${one.training_seed}`),
      ...told.map((name) => { const value = estimate(one, name), { decimals, unit } = METRICS[name]; return [withUnit(value.mean, decimals, unit), value.high > value.low && METRICS[name].interval ? h("span", { class: "of" }, spanText(one, value, decimals + 1)) : null]; }),
    ])),
  ] : null;
};

// The agent in a few sentences.
const story = (result, task) => {
  const words = wordsOf(task), of = (metric) => estimate(result, metric).mean, days = (task.steps * task.step_seconds) / 86400;
  const profit = of(PROFIT);
  const costs = words.bought.map((item) => [lower(item.label), of(item.money), gasOf(task, item.column, of(item.amount))]).sort((a, b) => b[1] - a[1]);
  const unused = words.bought.filter((item) => of(item.amount) !== null && of(item.amount) < 5e-3).map((item) => lower(item.label));
  const outside = words.outside ? of(words.outside) : 0, hours = (task.steps * task.step_seconds) / 3600;
  // Heat and power are sold, but do not grow.
  const isEnergy = (item) => Boolean(words.metric[item.amount]?.unit.startsWith("kWh")), worth = words.sold.filter((item) => Math.abs(of(item.money)) >= 5e-3);
  const grown = worth.filter((item) => !isEnergy(item) && of(item.amount) >= 0), shrunk = worth.filter((item) => !isEnergy(item) && of(item.amount) < 0), traded = worth.filter(isEnergy);
  const limits = words.violations.map((metric) => [lower(metric.label), of(metric.name)]).sort((a, b) => b[1] - a[1]);
  return [
    standingWords(result, task), `In the ${number(days, 0)} days it ${grown.length ? `grew ${sentence(grown.map((item) => `${withUnit(of(item.amount), 1, words.metric[item.amount]?.unit)} of ${lower(item.label)} worth ${withUnit(of(item.money), 2, "EUR/m\u00b2")}`))}${traded.length ? ", " : " and "}` : ""}${traded.length ? `got ${sentence(traded.map((item) => `${withUnit(of(item.money), 2, "EUR/m\u00b2")} for ${lower(item.label)}`))}, and ` : ""}${profit >= 0 ? "earned" : "lost"} `,
    h("b", { class: profit >= 0 ? "gain" : "loss" }, withUnit(Math.abs(profit), 2, "EUR/m\u00b2")),
    costs[0]?.[1] > 0 ? `. Most of the cost was ${costs[0][0]} (${withUnit(costs[0][1], 2, "EUR/m\u00b2")}${costs[0][2] ? `, ${costs[0][2]}` : ""}). ` : ". ",
    shrunk.map((item) => `${item.label} fell by ${withUnit(-of(item.amount), 1, words.metric[item.amount]?.unit)}, worth ${withUnit(-of(item.money), 2, "EUR/m\u00b2")}. `).join(""),
    outside > 0 ? `The climate was outside its limits for ${withUnit(outside, 0, "h")}, ${number((100 * outside) / hours, 0)} % of the time, above all ${limits[0][0]} (${withUnit(limits[0][1], 0, "h")}).` : "The climate never left its limits.",
    unused.length ? ` It used no ${sentence(unused).replace(" and ", " and no ")}.` : "",
  ];
};

// What the agent's makers say of it. A link is followed only where it is one of the web.
const cardPart = ({ card }) => (card ? [
  card.description ? h("p", {}, card.description) : null,
  h("p", { class: "small soft" }, [card.algorithm, card.authors ? `by ${sentence(card.authors)}` : "", card.training ? `trained for ${trainingWords(card.training)}` : ""].filter(Boolean).join("; "),
    /^https?:\/\//.test(card.link ?? "") ? [" \u00b7 ", h("a", { href: card.link, rel: "noopener noreferrer" }, "more about it")] : null),
] : null);

const failures = (result) => (result.failed ? h("div", { class: "missing" }, h("b", { class: "loss" }, `${result.failed} of ${result.runs} runs failed`), ". They count at the task\u2019s price of a missed step.",
  h("ul", {}, result.reasons.slice(0, 5).map(([seed, status, reason, steps]) => h("li", {}, `Seed ${seed}, ${status.replaceAll("_", " ")} after ${number(steps, 0)} steps: `, h("code", {}, reason))))) : null);

const earned = (result, task) => {
  const { items, columns, violations, sold, metric: METRICS } = wordsOf(task);
  const of = (metric) => estimate(result, metric);
  const tiles = columns.map((metric) => {
    const one = of(metric.name);
    return h("div", {}, h("dt", {}, metric.label), h("dd", {}, number(one.mean, metric.decimals), metric.unit ? h("small", {}, ` ${metric.unit}`) : null,
      h("small", { class: "of", title: spanWords(result, one, metric.decimals + 1) }, spanText(result, one, metric.decimals + 1))));
  });
  const build = () => {
    const values = items.map((item) => item.sign * of(item.money).mean);
    const rest = of(PROFIT).mean - sum(values), failed = result.failed && Math.abs(rest) > 5e-3;
    const steps = [0, ...values, ...(failed ? [rest] : [])].map(((total) => (value) => (total += value))(0)), ends = [Math.min(...steps), Math.max(...steps)], room = 0.14 * (ends[1] - ends[0] || 1);
    const labels = [...items.map((item) => item.label), ...(failed ? ["Missed steps"] : []), wordsOf(task).series[PROFIT].label];
    return {
      traces: [{
        type: "waterfall", orientation: "h", y: labels, x: [...values, ...(failed ? [rest] : []), of(PROFIT).mean], measure: [...values.map(() => "relative"), ...(failed ? ["relative"] : []), "total"],
        text: [...values, ...(failed ? [rest] : []), of(PROFIT).mean].map((value) => number(value, 2, true)), textposition: "outside", constraintext: "none", cliponaxis: false, hoverinfo: "skip",
        increasing: { marker: { color: variable("gain") } }, decreasing: { marker: { color: variable("loss") } }, totals: { marker: { color: variable("ink") } },
        connector: { line: { color: variable("line"), width: 1 } }, textfont: { color: variable("ink") },
      }],
      layout: layout({ margin: { l: 8, r: 56, t: 10, b: 8 }, hovermode: false, xaxis: { title: axisTitle("EUR/m\u00b2"), range: [ends[0] - room, ends[1] + room], zeroline: true, zerolinewidth: 1.5, zerolinecolor: variable("soft") }, yaxis: { autorange: "reversed", showgrid: false, tickmode: "linear", dtick: 1 } }),
    };
  };
  const hours = () => ({
    traces: [{
      type: "bar", orientation: "h", y: violations.map((metric) => metric.label), x: violations.map((metric) => of(metric.name).mean), marker: { color: variable("warm") },
      text: violations.map((metric) => ` ${number(of(metric.name).mean, 0)} h`), textposition: "outside", cliponaxis: false, hoverinfo: "skip", textfont: { color: variable("ink") },
    }],
    layout: layout({ hovermode: false, margin: { l: 8, r: 44, t: 10, b: 8 }, xaxis: { title: axisTitle("hours"), showgrid: false, showticklabels: false, rangemode: "tozero" }, yaxis: { autorange: "reversed", showgrid: false, tickmode: "linear", dtick: 1 }, bargap: 0.45 }),
  });
  const say = (names) => names.map((name) => `${METRICS[name].label} ${withUnit(of(name).mean, METRICS[name].decimals, METRICS[name].unit)}`).join(", ");
  return [
    h("h2", {}, "What it earned, and where"),
    h("dl", { class: "tiles" }, tiles, regretTile(result, task)),
    h("p", { class: "small soft" }, result.members ? "Below each mean: the lowest and the highest training." : `Below each mean: its 95 % interval over the ${wordsOf(task).draws}${isFixed(result) ? "" : ", for this one training"}. ${capital(wordsOf(task).beyond)}${isFixed(result) ? "" : " or another training"} can lie far outside.`),
    uncertaintyPart(result, task), betterNotes([result]),
    h("div", { class: "grid two" },
      chart(captionOf(`From ${sentence(sold.map((item) => lower(item.label))) || "cost"} to profit`, "EUR/m\u00b2, mean over the runs"), build, { height: 90 + 30 * items.length, says: say([...items.map((item) => item.money), PROFIT]) }),
      violations.length ? chart(captionOf("Time outside each limit", "hours, mean over the runs"), hours, { height: 260, says: say(violations.map((metric) => metric.name)) }) : null),
  ];
};

// For the ranking metric: the worst runs, each year, and the interval over trainings and runs of an agent with several trainings.
const uncertaintyPart = (result, task) => {
  if (pricesDiffer(task) || !result.worst_tenth) return null;
  const { label, decimals, unit } = wordsOf(task).metric[task.metric], overall = result.overall[task.metric], years = result.by_year.map(([year, runs, value]) => `${number(value, decimals + 1)} in ${year} (${plural(runs, "run")})`);
  return h("p", { class: "small" }, `${label}: ${withUnit(result.worst_tenth[0], decimals + 1, unit)} in the worst tenth of the runs (CVaR10).`,
    overall ? ` 95 % interval of the mean over runs and ${plural(result.trainings, "training")}: ${number(overall[0], decimals + 1)} to ${number(overall[1], decimals + 1)}.` : null,
    years.length ? ` Mean by the year of most days of a season: ${sentence(years)}. The intervals do not cover other years.` : null);
};

const noProfile = (result, task) => h("div", { class: "missing" },
  h("b", {}, "Days, season, calendar and worst run are not stored with this result."), h("p", {}, "Where its recorded actions still are beside it, ", h("code", {}, "glbench report --complete"), " makes them; else evaluate again: ",
    h("code", {}, `glbench evaluate ${result.agent} --task ${task.short} --fresh`)));

const provenance = (result) => h("details", { class: "data" }, h("summary", {}, "Where this result comes from"),
  h("p", { class: "small" }, result.reproduced ? "Reproduced: glbench verify simulated all runs again from the recorded actions and got the same numbers. " : "Not reproduced: no note of glbench verify is beside the result. ",
    `Stated by the file, not checked: decision time, training, sandbox, what the agent\u2019s makers say of it; made by glbench ${result.glbench} on ${result.created.slice(0, 10)}, kernel ${result.kernel}. Seeds ${result.seeds[0]} to ${result.seeds.at(-1)}. Result `, h("code", {}, result.digest.slice(0, 16)), ", agent ", h("code", {}, result.agent_digest.slice(0, 16)), "."));

const missingPage = (text) => ({ title: "Not found", content: [h("h1", {}, "Not found"), h("p", {}, text), h("p", {}, h("a", { href: "#/" }, "To the leaderboard"))] });

// A place for what has to be opened first; it keeps its height, so that nothing jumps.
const waiting = [];
const later = (height, make) => {
  const place = h("div", { style: { "min-height": `${height}px` }, "aria-busy": "true" });
  waiting.push(make().then((content) => { place.replaceChildren(...content.flat(Infinity).filter(Boolean)); place.style.minHeight = ""; place.removeAttribute("aria-busy"); explainTerms(); }));
  return place;
};

const profileParts = (result, task) => later(2400, async () => {
  const profile = await block(result.profile), { charts, controls, series } = wordsOf(task), has = (part) => (name) => profile[part].columns[name];
  const day = (names) => h("div", { class: names.length % 3 ? "grid" : "grid three" }, names.filter(has("day")).map((name) => dayChart(task, name, [{ agent: result.agent, packed: profile.day.columns[name] }], profile.day.slot_seconds)));
  const season = (name, options) => seasonChart(task, name, profile.season.columns[name], result.agent, options);
  return [
    h("h2", {}, "A typical day"),
    h("p", { class: "soft" }, `Median over all days and runs, with 50 % and 90 % bands; dotted lines are limits. Hours are ${hoursOf(task)}.`),
    day(charts.day), h("h3", {}, "Controls, share of capacity"), day(controls),
    h("details", { class: "data" }, h("summary", {}, `More of the day: growth, pipes, what was used, ${lower(wordsOf(task).metric[PENALTY].label)}`), h("div", {}, day(charts.more))),
    energyPart(profile, task),
    h("h2", {}, "The season"),
    h("p", { class: "soft" }, "Day by day: the median over the runs; the best run (dashed) and the worst run (dotted) where they can be told apart from it.", task.start ? "" : " Runs start on different days: day 1 is the first day of each."),
    h("div", { class: "grid" }, charts.season.filter(has("season")).map((name) => season(name, { add: Boolean(series[name].money) }))),
    weeksPart(profile, task),
    calendarPart(profile, task),
    worstPart(result, task, profile),
  ];
});
