// What the reader chooses: a task, an agent, prices.

const select = (label, options, chosen, change, id) => h("div", { class: "field" }, h("label", { for: id }, label),
  h("select", { id, onchange: (event) => change(event.target.value) }, options.map((option) => {
    const item = ({ value, text }) => h("option", { value, selected: value === chosen }, text);
    return option.group ? h("optgroup", { label: option.group }, option.options.map(item)) : item(option);
  })));

const SUITE_WORDS = { paper: "As the paper describes it", "paper-code": "As the paper's code does it" };
const suiteTitle = (name) => SUITE_WORDS[name] ?? `Suite ${name}`;

// A task by its id, as commands and addresses name it, and by its title.
const taskName = (task) => `${task.short}: ${task.title}`;

// Tasks by the suite that they belong to, for choosing one.
const taskGroups = (tasks = D.tasks) => {
  const groups = new Map();
  for (const task of tasks) {
    const key = task.suites?.[0] ?? "";
    groups.set(key, [...(groups.get(key) ?? []), task]);
  }
  return [...groups].map(([name, members]) => ({ name, title: name ? suiteTitle(name) : "Other tasks", members }));
};
const taskField = (chosen, change, tasks = D.tasks) => select("Task", taskGroups(tasks).map(({ title, members }) => ({
  group: title, options: members.map((task) => ({ value: task.short, text: taskName(task) })),
})), chosen, change, "choose-task");

const agentField = (label, chosen, change, names, id) => select(label, names.map((name) => ({ value: name, text: name })), chosen, change, id);

// A number as people write it, with a decimal point or a decimal comma: the number, or in words why it is none. One sign alone is read as the
// decimal sign and the reader sees what was understood; with two nobody can know which of them separates thousands.
const readNumber = (text, least, most) => {
  const written = text.replace(/[\s\u00a0\u202f]/g, "").replace(/^[\u2212\u2013]/, "-"), quoted = `\u201c${text.trim()}\u201d`;
  if (!written) return { refusal: `Empty. Write a number from ${least} to ${most}, such as 0.05 or 0,05.` };
  if (/[.,].*[.,]/.test(written) && /^[-+]?[\d.,]+$/.test(written)) return { refusal: `${quoted} has more than one point or comma, so which is the decimal sign is not clear. Write thousands without a sign: 1234.5 or 1234,5.` };
  if (!/^[-+]?(\d+([.,]\d*)?|[.,]\d+)$/.test(written)) return { refusal: `${quoted} is not a number. Write digits with one decimal point or comma, such as 0.05 or 0,05; the unit is already there.` };
  const value = Number(written.replace(",", "."));
  return value < least || value > most ? { refusal: `${value} is outside ${least} to ${most}.` } : { value };
};

// Prices to try: whatever follows from amounts follows at once.
const priceField = (task, changed) => {
  if (!task.prices) return null;
  const prices = pricesOf(task), differ = pricesDiffer(task), { items } = wordsOf(task), tables = items.filter((item) => item.table);
  const choose = (name, value) => { chosenPrices[task.words_of] = { ...chosenPrices[task.words_of], [name]: value }; changed(`price-${name}`); };
  const field = (name, label, least, unit) => {
    const understood = h("output", { id: `understood-${name}`, for: `price-${name}`, class: "understood" });
    const say = (input) => {
      const { value, refusal } = readNumber(input.value, least, 100);
      input.setAttribute("aria-invalid", String(Boolean(refusal)));
      understood.className = `understood${refusal ? " refused" : ""}`;
      understood.textContent = refusal ?? `= ${number(value, Math.max(2, (String(value).split(".")[1] ?? "").length))}${unit ? `\u00a0${unit}` : ""}`;
      return value;
    };
    const input = h("input", {
      id: `price-${name}`, type: "text", value: String(prices[name]), inputmode: least < 0 ? null : "decimal", autocomplete: "off", "aria-describedby": `understood-${name}`,
      oninput: (event) => say(event.target), onchange: (event) => { const value = say(event.target); if (value !== undefined) choose(name, value); },
    });
    say(input);
    return h("div", { class: "field" }, h("label", { for: `price-${name}` }, label), input, understood);
  };
  const tariff = (item) => {
    const { money, label, unit, least } = item, mean = meanPrice(task, item), course = [{ value: "0", text: "as in the task" }, { value: "1", text: `flat, ${number(mean, 4)}` }];
    return h("fieldset", { class: "tariff" }, h("legend", {}, `${label}, ${unit}`),
      mean === null ? null : select("Course", course, String(prices[flatOf(money)]), (value) => choose(flatOf(money), Number(value)), `price-${flatOf(money)}`),
      field(money, "times", Number(least), ""), field(addedTo(money), "plus", -100, unit));
  };
  return h("details", { class: `prices${differ ? " changed" : ""}`, id: "prices", open: pricesOpen, ontoggle: (event) => { pricesOpen = event.target.open; } },
    h("summary", {}, differ ? [h("b", {}, "Other prices: "), sentence(items.map((item) => priceWords(task, item)).filter(Boolean))] : [h("b", {}, "What if prices were different?"), " Change them, and the ranking follows."]),
    h("form", { onsubmit: (event) => event.preventDefault() }, items.filter((item) => !item.table).map(({ money, label, unit, least }) => field(money, `${label}, ${unit}`, Number(least), unit)), tables.map(tariff),
      h("button", { class: "plain", type: "button", id: "reset-prices", disabled: !differ, onclick: () => { delete chosenPrices[task.words_of]; changed("reset-prices"); } }, "Back to the task\u2019s prices")),
    h("p", { class: "soft small" }, `Amounts stay as they were: the agents decided without knowing these prices. Profit and ${lower(wordsOf(task).metric[SCORE].label)} are computed again for every run, intervals (Student\u2019s t) here in the page.${task.reward_modules.includes("scaled_epi") && !task.stated_scale ? " The scale of the reward moves with the prices: compare rewards with each other, not with those before." : ""}${tables.length ? tableWords(task, tables) : ""}`));
};
// How a price differs from the task's, or nothing.
const priceWords = (task, item) => {
  const { money, label, unit, table } = item, prices = pricesOf(task), changed = differing(task).filter((name) => [money, addedTo(money), flatOf(money)].includes(name));
  if (!changed.length) return "";
  if (!table) return `${lower(label)} ${prices[money]} instead of ${task.prices[money]} ${unit}`;
  const added = prices[addedTo(money)];
  return `${lower(label)} ${[prices[flatOf(money)] ? `flat at ${number(meanPrice(task, item), 4)}` : "", prices[money] !== 1 ? `\u00d7 ${prices[money]}` : "", added ? `${added < 0 ? MINUS : "+"} ${Math.abs(added)}` : ""].filter(Boolean).join(" ")} ${unit}`;
};
// What is exact where prices change with the calendar.
const tableWords = (task, tables) => {
  const met = tables.filter((item) => task.mean_prices[item.money] === null);
  return ` Prices that change with the calendar are multiplied first, then added to. That is exact for every run: its money at the task\u2019s prices and its amounts are in its result. A flat price is the mean over the day${met.length ? `, and for ${sentence(met.map((item) => lower(item.label)))} the mean price that the runs here met` : ""}.`;
};
let pricesOpen = false;
