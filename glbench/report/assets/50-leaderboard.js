// The leaderboard of a task, and the figure of its family.

const rankState = { key: "rank", direction: "ascending" };
// Doing nothing lies so far away that all others would look alike beside it.
const NOTHING = "do_nothing";
const hidden = new Set(ENTRIES.length > 2 ? [NOTHING] : []);

// Entries of which each training is shown, by name.
const unfolded = new Set();

const rankColumns = (task, rows, refill) => {
  const hours = (task.steps * task.step_seconds) / 3600, [first, ...others] = wordsOf(task).columns;
  const metricColumn = (metric) => {
    const of = (row) => estimate(row.result, metric.name);
    const shown = rows.filter((row) => row.rank !== null);
    const drawn = shown.length ? shown : rows, range = barRange(drawn.map(of), drawn.map((row) => row.result.agent), metric.better);
    return {
      key: metric.name, label: metric.label, unit: metric.unit || "\u00a0", value: (row) => of(row).mean,
      start: metric.better === "low" ? "ascending" : "descending",
      explain: [...explained(metric), metric.kind === "outside" ? ` The period has ${number(hours, 0)} hours.` : ""],
      cell: (row) => {
        const one = of(row);
        const title = spanWords(row.result, one, metric.decimals + 1);
        return h("td", { title: metric.interval ? title : null }, number(one.mean, metric.decimals), metric.interval ? bar(one, range, row.result.agent, Boolean(row.result.members)) : null,
          metric.name === task.metric && row.result.worst_tenth && !pricesDiffer(task) ? h("span", { class: "of", title: `Mean of the worst tenth of the runs (CVaR10)${row.result.members ? ", mean over the trainings" : ""}` }, "worst tenth ", h("br"), number(row.result.worst_tenth[0], metric.decimals)) : null,
          metric.name === task.metric && row.result.fresh_draws ? freshWords(row.result.fresh_draws, metric) : null,
          metric.interval ? h("span", { class: "visually-hidden" }, ` (${title})`) : null);
      },
    };
  };
  return [
    { key: "rank", label: "#", value: (row) => row.rank, start: "ascending", className: "rank", explain: otherWords("Rank"), cell: (row) => h("td", { class: "rank" }, row.result.member_of ? "" : row.rank ?? "\u2013") },
    { key: "agent", label: "Agent", value: (row) => row.result.agent, left: true, start: "ascending", className: "agent",
      explain: [h("b", {}, "Agent"), ": open one to see where it earns its money, a typical day, the season and its worst run."],
      cell: (row) => h("th", { scope: "row", class: "agent" }, row.result.member_of ? null : swatch(row.result.agent),
        h("a", { href: link("agent", row.result.agent, task.short) }, row.result.member_of ? `seed ${row.result.training_seed}` : breakable(row.result.agent)),
        row.result.privileged && !row.result.member_of ? h("span", { class: "of" }, "privileged") : null, row.result.members ? [" ", unfold(row.result, refill)] : row.result.trainings ? h("span", { class: "of" }, plural(row.result.trainings, "training")) : null,
        row.result.failed ? h("span", { class: "of loss" }, `${row.result.failed} of ${row.result.runs} runs failed`) : null, row.result.remark ? h("span", { class: "of" }, row.result.remark) : null,
        row.result.saw_scored ? h("span", { class: "of loss" }, `\u00a7 ${row.result.saw_scored}`) : null) },
    metricColumn(first), regretColumn(task, rows), ...others.filter((metric) => metric.kind !== "amount" || !isUnused(metric, rows)).map(metricColumn),
  ].filter(Boolean);
};

// Mean of the ranking metric with fresh draws, and the mark of an agent that dropped by more than reference agents.
const freshWords = (fresh, metric) => h("span", { class: fresh.marked ? "of loss" : "of", title: fresh.marked ? "It dropped by more than reference agents in the same seasons: it may know the published draws." : "Mean of a second evaluation, with draws that did not exist when the agent was handed in." },
  `${fresh.marked ? "\u00b6 " : ""}fresh draws`, h("br"), number(fresh.mean, metric.decimals));

// An amount that nobody has: its column would push the last ones off the page.
const isUnused = (metric, rows) => rows.every((row) => !(Math.abs(estimate(row.result, metric.name).mean) >= 0.5 * 10 ** -metric.decimals));
const unusedWords = (task, rows) => {
  const unused = wordsOf(task).columns.filter((metric) => metric.kind === "amount" && isUnused(metric, rows)).map((metric) => lower(metric.label));
  return unused.length ? ` No agent has any ${sentence(unused).replace(" and ", " or ")}.` : "";
};

// Shows the trainings of an entry below it, or hides them.
const unfold = (result, refill) => h("button", {
  type: "button", class: "unfold", "aria-expanded": String(unfolded.has(result.agent)), "data-unfold": result.agent,
  onclick: () => { unfolded.has(result.agent) ? unfolded.delete(result.agent) : unfolded.add(result.agent); refill(); document.querySelector(`[data-unfold="${CSS.escape(result.agent)}"]`)?.focus(); },
}, plural(result.trainings, "training"));

// How an agent came to its decisions, and how far one can trust the result: the same table for a task and for a suite.
const aboutState = { key: null, direction: "ascending" };
const seesNothing = (row) => Boolean(row.sees?.startsWith("nothing"));
const aboutTable = (rows, head, of) => [
  h("h2", {}, "How they decide, and how far to trust it"),
  sortable({ caption: "What each agent sees, how long it decides and was trained, and where its result comes from", rows, state: aboutState, className: "about board", columns: [head, ...aboutColumns(of)] }).element,
  h("p", { class: "small soft" }, STATED),
];
const aboutColumns = (of) => [
  { key: "decision", label: "Decision", unit: "ms", value: (row) => of(row).decision, start: "ascending", explain: otherWords("Decision"),
    cell: (row) => h("td", {}, number(of(row).decision, of(row).decision < 0.1 ? 3 : of(row).decision < 10 ? 2 : 0)) },
  { key: "training", label: "Training", unit: "steps", value: (row) => of(row).steps ?? null, start: "ascending", explain: otherWords("Training"),
    cell: (row) => { const { steps, hours } = of(row); return h("td", { title: hours || null }, steps === null || steps === undefined ? "\u2013" : millions(steps)); } },
  { key: "sees", label: "Sees", value: (row) => (of(row).privileged ? "privileged" : seesNothing(of(row)) ? "nothing" : "observed"), start: "ascending", left: true, explain: otherWords("Sees"),
    cell: (row) => h("td", { class: "left", title: of(row).sees ?? null }, of(row).privileged ? tag("privileged") : seesNothing(of(row)) ? "nothing" : "observed") },
  { key: "sandbox", label: "Sandbox", value: (row) => SANDBOX_WORDS[of(row).sandbox]?.[0] ?? "", left: true, start: "ascending", explain: otherWords("Sandbox"),
    cell: (row) => { const [words, kind] = SANDBOX_WORDS[of(row).sandbox] ?? ["\u2013", ""]; return h("td", { class: "left" }, kind === "bad" ? tag(words, kind) : words); } },
  { key: "source", label: "Source", value: (row) => `${of(row).origin} ${of(row).reproduced ? 0 : 1}`, left: true, start: "ascending", explain: [...otherWords("Source"), " ", ...otherWords("Reproduced")],
    cell: (row) => h("td", { class: "left" }, of(row).origin === "trial" ? tag("trial") : of(row).origin, of(row).reproduced ? h("span", { class: "ok", title: "reproduced" }, " \u2713", h("span", { class: "visually-hidden" }, " reproduced")) : null, of(row).confirmed ? h("span", { class: "of" }, "yours is the same") : null) },
];
const STATED = "\u2713 reproduced: glbench verify simulated all runs again from the recorded actions and got the same numbers. Stated by the result files, not checked: decision time, training, sandbox.";
const millions = (steps) => (steps >= 1e6 ? `${number(steps / 1e6, 2)}\u00a0M` : steps >= 1e3 ? `${number(steps / 1e3, 0)}\u00a0k` : number(steps, 0));

const sourceOf = (result) => (result.confirmed ? `${result.origin}, yours is the same` : result.origin);
const SANDBOX_WORDS = { bubblewrap: ["yes", "ok"], unsandboxed: ["no", "bad"], "built-in": ["built in", ""] };
const trainingWords = (training) => (training ? [training.steps ? `${number(training.steps, 0)} control steps` : "", training.wall_hours ? `${number(training.wall_hours, 1)} hours` : "", training.hardware ? `on ${training.hardware}` : ""].filter(Boolean).join(", ") : "");

const otherWords = (name) => { const [word, meaning] = D.other_words.find(([one]) => one === name); return [h("b", {}, word), `: ${meaning}`]; };

// The paper's figure: reward, profit and penalty against delta, with 95 % intervals, one line an agent.
const familyFigure = (family) => {
  const tasks = family.tasks.map((id) => TASKS[id]), { headlines: HEADLINES, metric: METRICS } = wordsOf(tasks[0]);
  const names = ENTRIES.map((agent) => agent.name).filter((name) => family.tasks.some((id) => resultOf(id, name)?.rank));
  const build = (metric) => () => ({
    traces: names.filter((name) => !hidden.has(name)).map((name) => {
      const points = tasks.filter((task) => resultOf(task.id, name)?.rank).map((task) => ({ x: task.delta, ...estimate(resultOf(task.id, name), metric) }));
      const column = (key) => points.map((point) => point[key]);
      return line(column("x"), column("mean"), colourOf(name), {
        mode: "lines+markers", name: plain(name), marker: { size: 7, symbol: symbolOf(name) }, line: { dash: dashOf(name) }, hovertemplate: `%{y:,.${METRICS[metric].decimals + 1}f}`,
        error_y: { type: "data", symmetric: false, array: points.map((p) => p.high - p.mean), arrayminus: points.map((p) => p.mean - p.low), thickness: 1.5, width: 0, color: colourOf(name) },
      });
    }),
    layout: layout({ xaxis: { title: { text: "delta, %", standoff: 6 }, tickvals: tasks.map((task) => task.delta) }, yaxis: { title: axisTitle(METRICS[metric].unit || METRICS[metric].label) }, hovermode: "x unified" }),
  });
  const leaders = new Map();
  for (const task of tasks) {
    const { first, tied } = standing(task);
    if (first) leaders.set(first.result.agent, [...(leaders.get(first.result.agent) ?? []), `${task.delta} %${tied.length ? " (shared)" : ""}`]);
  }
  const figures = HEADLINES.map((metric) => chart([METRICS[metric].label, METRICS[metric].unit ? h("span", {}, ` ${METRICS[metric].unit}`) : null],
    build(metric), { height: 280, says: `${METRICS[metric].label} of ${sentence(names)} against delta; the same numbers are in the table below.` }));
  const legend = h("ul", { class: "legend", "aria-label": "Agents in the figure" }, names.map((name) => h("li", {}, h("button", {
    type: "button", "aria-pressed": String(!hidden.has(name)),
    onclick: (event) => {
      hidden.has(name) ? hidden.delete(name) : hidden.add(name);
      event.currentTarget.setAttribute("aria-pressed", String(!hidden.has(name)));
      redrawCharts();
    },
  }, swatch(name), name))));
  const rows = (metric) => names.map((name) => [name, ...tasks.map((task) => {
    const result = resultOf(task.id, name);
    return result?.rank ? number(estimate(result, metric).mean, METRICS[metric].decimals) : "\u2013";
  })]);
  return [
    h("h2", {}, "How each agent copes with a crop it does not know"),
    h("p", {}, `${[...leaders].map(([name, levels]) => `${name} leads at ${sentence(levels)}`).join("; ")}. Shared: others cannot be told apart from it.`),
    h("p", { class: "soft" }, `${suiteTitle(family.name)}: mean over the runs with its 95 % interval, of several trainings with their range, against delta, the share by which the crop\u2019s properties may be off. Intervals cover the ${wordsOf(tasks[0]).draws} and one training. Choose agents below.${names.includes(NOTHING) && hidden.has(NOTHING) ? ` ${NOTHING} is switched off at first: beside it all others would look alike.` : ""}`),
    legend, h("div", { class: "grid three" }, figures),
    h("details", { class: "data" }, h("summary", {}, "These figures as tables"), HEADLINES.map((metric) =>
      plainTable(`${METRICS[metric].label}${METRICS[metric].unit ? `, ${METRICS[metric].unit}` : ""}, mean, by delta`, ["Agent", ...tasks.map((task) => `${task.delta} %`)], rows(metric)))),
  ];
};

const leaderboardPage = (short) => {
  const task = BY_SHORT[short] ?? TASKS[D.start], rows = ranked(task.id), family = familyOf(task.id);
  const best = rows[0].result;
  const columns = rankColumns(task, rows, () => table.fill()), table = sortable({
    caption: `${taskName(task)}: mean over ${plural(best.seeds.length, "seeded run")}${pricesDiffer(task) ? ", at other prices" : ""}. Bars show 95 % intervals over the ${wordsOf(task).draws} and one training, of several trainings (hollow) the range from the lowest to the highest; an arrow is off their scale.${unusedWords(task, rows)}`,
    columns, rows, state: rankState,
    below: (row) => (unfolded.has(row.result.agent) ? trainingsOf(row.result).map((result) => ({ result, rank: null })) : []), className: "ranks board", rowClass: (row) => (row.result.member_of ? "member" : row.rank === null ? "unranked" : null),
  });
  return {
    title: "Leaderboard",
    content: [
      h("h1", {}, "Who grows the most for the least?"),
      h("p", { class: "story" }, leadWords(task)),
      task.draws ? h("p", { class: "note" }, `This board: ${task.draws}. It is never mixed with results of other draws.`) : null,
      h("div", { class: "fields" }, taskField(task.short, (value) => go("", value))),
      h("p", { class: "soft" }, wordsOf(task).lead),
      priceField(task, (focus) => show(focus)),
      table.element,
      h("p", { class: "small" }, h("a", { href: link("task", task.short) }, "What exactly is this task?"), " \u00b7 ", h("a", { href: link("guide") }, "How to read this page")),
      violationsOf(task, rows),
      regretFigure(task, rows),
      family ? familyFigure(family) : null,
      aboutTable(rows, { ...columns[1], cell: (row) => h("th", { scope: "row", class: "agent" }, swatch(row.result.agent), breakable(row.result.agent)) }, (row) => ({ ...row.result, steps: row.result.training?.steps, hours: trainingWords(row.result.training) })),
    ],
  };
};
