// What an agent grew, used and earned by week, from the median run of each day.

const weeksPart = (profile, task) => {
  const { items, series } = wordsOf(task), columns = profile.season.columns;
  const days = (task.steps * task.step_seconds) / 86400, weeks = Math.ceil(days / 7), lengthOf = (week) => Math.min(7, days - 7 * week);
  const byWeek = (name) => {
    const values = unpack(columns[name])[0];
    return Array.from({ length: weeks }, (_, week) => { const days = values.slice(7 * week, 7 * week + 7); return days.includes(null) ? null : sum(days); });
  };
  // Amounts in the unit of a day's sum, without its "a day"; light as the mean of a day.
  const amount = (name) => ({ label: series[name].label, unit: (series[name].daily ?? "").replace(/ a day$/, ""), factor: series[name].daily_factor ?? series[name].factor ?? 1, decimals: Math.min(series[name].daily_decimals ?? series[name].decimals, 2), values: byWeek(name) });
  const gas = (name) => ({ label: series[name].gas, unit: "m\u00b3/m\u00b2", factor: 1 / D.kwh_a_cubic_metre, decimals: 2, values: byWeek(name) });
  const lights = ["par"].filter((name) => columns[name]).map((name) => ({ ...amount(name), unit: series[name].daily, values: byWeek(name).map((value, week) => (value === null ? null : value / lengthOf(week))) }));
  const amounts = [...new Set(items.map((item) => item.column))].filter((name) => columns[name]).flatMap((name) => [amount(name), ...(series[name].gas ? [gas(name)] : [])]);
  const money = [PROFIT, PENALTY].filter((name) => columns[name]).map((name) => ({ label: wordsOf(task).metric[name].label, unit: name === PROFIT || inMoney(task, name) ? "EUR/m\u00b2" : "", factor: 1, decimals: name === PROFIT || inMoney(task, name) ? 2 : 1, values: byWeek(name) }));
  const shown = [...lights, ...amounts, ...money].filter(({ values, factor, decimals }) => values.some((value) => Math.abs(value * factor) >= 0.5 * 10 ** -decimals));
  if (!shown.length) return null;
  return h("details", { class: "data", id: "weeks" }, h("summary", {}, "By week: light, yield, heat, gas, power, CO\u2082 and profit"),
    plainTable(`By week, ${task.clock}: sums of each day\u2019s median over the runs${pricesDiffer(task) ? ", at the task\u2019s prices" : ""}. Gas by its lower heating value, 31.65 MJ/m\u00b3.`, [task.start ? "Week from" : "Week", ...shown.map(({ label, unit }) => [label, unit ? h("span", { class: "unit" }, unit) : null])],
      Array.from({ length: weeks }, (_, week) => [`${task.start ? date(task.start, 7 * week, SHORT_DATE) : week + 1}${lengthOf(week) < 7 ? ` (${plural(lengthOf(week), "day")})` : ""}`, ...shown.map(({ values, factor, decimals }) => number(values[week] === null ? null : values[week] * factor, decimals))])),
    h("p", { class: "small soft" }, "Exact sums of every entry of the ledger, beside those of another agent: ", h("code", {}, "glbench story RESULT.json --page FILE.html"), "."));
};
