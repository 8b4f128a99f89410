// What to conclude, in sentences that are computed from the data. Agents are told apart only where their ranks differ and the interval of their
// paired difference leaves out 0; of those that are not, none is called better.

// Whether the difference between two results is beyond chance: without draws every difference of ranks is.
const isClear = ({ mean: center, low, high }) => center !== null && low !== null && (high > low ? low * high > 0 : center !== 0);
const apart = (one, two, task) => (one.rank === null || one.rank !== two.rank) && isClear(difference(one.result, two.result, task.metric));

// Who leads among those that see no more than observations (or among all, if none does), who cannot be told apart from it, and who is next.
const standing = (task) => {
  const rows = ranked(task.id).filter((row) => row.rank !== null), usual = rows.filter((row) => !row.result.privileged), field = usual.length ? usual : rows;
  const [first, ...others] = field, isTied = others.map((row) => !apart(first, row, task));
  return { rows, first, usual: usual.length > 0, tied: others.filter((_, i) => isTied[i]), next: others.find((_, i) => !isTied[i]) };
};

const betweenWords = ({ low, high }, decimals, unit = "", signed = true) => (high > low ? ` (95 % interval ${number(low, decimals, signed)} to ${number(high, decimals, signed)}${unit ? `\u00a0${unit}` : ""})` : "");
const namesOf = (rows, most = 3) => (rows.length > most ? `${rows.slice(0, most - 1).map((row) => row.result.agent).join(", ")} and ${rows.length - most + 1} others` : sentence(rows.map((row) => row.result.agent)));
// How much the seed of a training may matter.
const trainingNote = (result) => (result.members ? `mean of ${plural(result.trainings, "training")}` : result.training?.steps ? "a single training; another one of the same recipe may do better or worse" : "");
const gasOf = (task, column, kilowattHours) => (wordsOf(task).series[column]?.gas ? `${withUnit(kilowattHours / D.kwh_a_cubic_metre, 1, "m\u00b3/m\u00b2")} of gas` : "");

// What one uses, brings and breaks more or less than the other: the three amounts that weigh most in money, and the hours outside limits, where the
// difference is beyond chance.
const amountWords = (one, two, task) => {
  const words = wordsOf(task), items = [...new Map(words.items.map((item) => [item.amount, item])).values()].filter((item) => words.metric[item.amount]);
  const gaps = items.map((item) => ({ item, metric: words.metric[item.amount], gap: difference(one, two, item.amount) })).filter(({ metric, gap }) => isClear(gap) && Math.abs(gap.mean) >= 0.5 * 10 ** -metric.decimals)
    .sort((a, b) => Math.abs(difference(one, two, b.item.money).mean) - Math.abs(difference(one, two, a.item.money).mean)).slice(0, 3);
  const hours = words.outside ? difference(one, two, words.outside) : UNKNOWN, side = (gap) => (gap > 0 ? "more" : "less");
  return [
    ...gaps.map(({ item, metric, gap }) => { const gas = gasOf(task, item.column, Math.abs(gap.mean)); return `${item.sign > 0 ? "brings" : "uses"} ${withUnit(Math.abs(gap.mean), metric.decimals, metric.unit)} ${side(gap.mean)} ${lower(metric.label)}${gas ? ` (${gas})` : ""}`; }),
    ...(isClear(hours) && Math.abs(hours.mean) >= 0.5 ? [`spends ${withUnit(Math.abs(hours.mean), 0, "h")} ${side(hours.mean)} outside the limits`] : []),
  ];
};

// The first words of a task: who leads, by how much, whether that is beyond chance, and what it means in heat, power and fruit.
const leadWords = (task) => {
  const { rows, first, usual, tied, next } = standing(task), { label, decimals, unit: inMoneyOr } = wordsOf(task).metric[task.metric], unit = inMoneyOr || "points";
  if (!first) return ["No result here has all runs of the task, so nothing is ranked."];
  const one = estimate(first.result, task.metric), note = trainingNote(first.result), gap = next ? difference(first.result, next.result, task.metric) : null;
  const amounts = next ? amountWords(first.result, next.result, task) : [], [best] = rows, ahead = usual && best.result.privileged;
  return [
    h("b", {}, first.result.agent), tied.length ? " has the highest mean " : " leads with a mean ", `${lower(label)} of ${withUnit(one.mean, decimals, unit)}${note ? ` (${note})` : ""}`,
    usual && rows.some((row) => row.result.privileged) ? " among the agents that see no more than observations" : usual ? "" : "; all agents here are privileged", ". ",
    tied.length ? `${namesOf(tied)} cannot be told apart from it. ` : "",
    next ? [tied.length ? `The first that it is told apart from is ` : `The next is `, h("b", {}, next.result.agent), `, ${withUnit(gap.mean, decimals, unit)} below${betweenWords(gap, decimals, "", false)}${tied.length ? "" : ", told apart"}${amounts.length ? `: against it ${first.result.agent} ${sentence(amounts)}` : ""}. `] : rows.length > 1 && tied.length ? "No agent here is told apart from it. " : "",
    ahead ? `The privileged ${best.result.agent} reaches ${withUnit(estimate(best.result, task.metric).mean, decimals, unit)}.` : "",
  ];
};

// Where an agent stands among the others of its task.
const standingWords = (result, task) => {
  const rows = ranked(task.id).filter((row) => row.rank !== null), row = rows.find((one) => one.result === result), { label, decimals, unit } = wordsOf(task).metric[task.metric];
  const value = estimate(result, task.metric), note = trainingNote(result), [best] = rows;
  const words = [h("b", {}, result.agent), ` has a mean ${lower(label)} of ${withUnit(value.mean, decimals, unit)}${result.members ? "" : betweenWords(value, decimals, "", false)} on ${task.short}`], trained = note ? `It is ${result.members ? "the " : ""}${note}. ` : "";
  if (!row) return [...words, result.member_of ? ". " : "; it is not ranked. ", trained];
  const others = rows.filter((one) => one !== row), alike = others.filter((one) => !apart(row, one, task)), gap = best === row ? null : difference(best.result, result, task.metric), more = (name) => difference(best.result, result, name).mean, profit = more(PROFIT);
  return [
    ...words, `: rank ${row.rank} of ${rows.length}. `, trained, alike.length ? `${namesOf(alike)} cannot be told apart from it. ` : others.length ? "It is told apart from every other agent here. " : "",
    gap && apart(best, row, task) ? ["The best here, ", h("a", { href: link("agent", best.result.agent, task.short) }, best.result.agent), best.result.privileged ? " (privileged)" : "", `, is ${withUnit(gap.mean, decimals, unit)} higher${betweenWords(gap, decimals, "", false)}, with ${withUnit(Math.abs(profit), 2, "EUR/m\u00b2")} ${profit >= 0 ? "more" : "less"} profit and ${moreViolations(task, more(PENALTY))}. `] : "",
  ];
};

// The same over a suite. The interval of the difference to the tuned rules is paired; where there is none, ranks and regrets speak.
const suiteWords = (suite) => {
  const rows = suite.rows.filter((row) => row.rank !== null), usual = rows.filter((row) => !row.figures?.privileged), [first, ...others] = usual.length ? usual : rows;
  if (!first) return ["No agent has results on all tasks of this suite yet."];
  const tied = others.filter((row) => row.rank === first.rank), next = others.find((row) => row.rank !== first.rank), tasks = plural(suite.tasks.length, "task");
  const worth = ({ against_rules: rules, regret, mean: normalised }) => {
    if (!rules && suite.in_money) return `earns ${withUnit(normalised[0], 2, "EUR/m\u00b2")} in the mean`;
    if (!rules) return regret ? `stays ${withUnit(regret[0], 2, "EUR/m\u00b2")} below the best known runs${betweenWords({ low: regret[1], high: regret[2] }, 2, "", false)}` : `has a normalised score of ${score(normalised[0])}`;
    const between = betweenWords({ low: rules[1], high: rules[2] }, 2);
    return isClear({ mean: rules[0], low: rules[1], high: rules[2] }) ? `earns ${withUnit(Math.abs(rules[0]), 2, "EUR/m\u00b2")} ${rules[0] > 0 ? "more" : "less"} than the tuned rules${between}` : `cannot be told apart from the tuned rules in money, ${withUnit(rules[0], 2, "EUR/m\u00b2", true)}${between}`;
  };
  const trained = first.trainings[1] > 1 ? `It is the mean of ${trainingsWords(first)} a task. ` : first.figures?.training ? "It is a single training a task; another one of the same recipe may do better or worse. " : "";
  const of = usual.length && usual.length < rows.length ? " the agents that see no more than observations" : "";
  return [
    h("b", {}, first.agent), tied.length ? ` has the highest mean score${of && ` of${of}`}` : ` leads${of}`, `: over the ${tasks} it ${worth(first)}. `, trained,
    tied.length ? `${sentence(tied.slice(0, 3).map((row) => row.agent))}${tied.length > 3 ? ` and ${tied.length - 3} others` : ""} cannot be told apart from it. ` : "",
    next ? [`The ${tied.length ? "first that ranks behind it" : "next"} is `, h("b", {}, next.agent), `, which ${worth(next)}.`] : "",
  ];
};
