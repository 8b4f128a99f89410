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

// Prices to try: whatever follows from amounts follows at once.
const priceField = (task, changed) => {
  if (!task.prices) return null;
  const prices = pricesOf(task), differ = pricesDiffer(task), { items } = wordsOf(task), tables = items.filter((item) => item.table);
  const choose = (name, value) => { chosenPrices[task.words_of] = { ...chosenPrices[task.words_of], [name]: value }; changed(`price-${name}`); };
  const field = (name, label, least, step) => h("div", { class: "field" },
    h("label", { for: `price-${name}` }, label),
    h("input", {
      id: `price-${name}`, type: "number", min: least, max: "100", step, value: prices[name], inputmode: "decimal", required: true,
      onchange: (event) => {
        if (!event.target.checkValidity() && (event.target.validity.rangeUnderflow || event.target.validity.rangeOverflow || event.target.validity.valueMissing || event.target.validity.badInput)) { event.target.reportValidity(); return; }
        choose(name, Number(event.target.value));
      },
    }));
  const tariff = (item) => {
    const { money, label, unit, least } = item, mean = meanPrice(task, item), course = [{ value: "0", text: "as in the task" }, { value: "1", text: `flat, ${number(mean, 4)}` }];
    return h("fieldset", { class: "tariff" }, h("legend", {}, `${label}, ${unit}`),
      mean === null ? null : select("Course", course, String(prices[flatOf(money)]), (value) => choose(flatOf(money), Number(value)), `price-${flatOf(money)}`),
      field(money, "times", least, "0.1"), field(addedTo(money), "plus", "-100", "0.01"));
  };
  return h("details", { class: `prices${differ ? " changed" : ""}`, id: "prices", open: pricesOpen, ontoggle: (event) => { pricesOpen = event.target.open; } },
    h("summary", {}, differ ? [h("b", {}, "Other prices: "), sentence(items.map((item) => priceWords(task, item)).filter(Boolean))] : [h("b", {}, "What if prices were different?"), " Change them, and the ranking follows."]),
    h("form", { onsubmit: (event) => event.preventDefault() }, items.filter((item) => !item.table).map(({ money, label, unit, least }) => field(money, `${label}, ${unit}`, least, least || "0.01")), tables.map(tariff),
      h("button", { class: "plain", type: "button", id: "reset-prices", disabled: !differ, onclick: () => { delete chosenPrices[task.words_of]; changed("reset-prices"); } }, "Back to the task\u2019s prices")),
    h("p", { class: "soft small" }, `Amounts stay as they were: the agents decided without knowing these prices. Profit and ${lower(wordsOf(task).metric[SCORE].label)} are computed again for every run, intervals by a bootstrap of 2,000 samples here in the page.${task.reward_modules.includes("scaled_epi") && !task.stated_scale ? " The scale of the reward moves with the prices: compare rewards with each other, not with those before." : ""}${tables.length ? tableWords(task, tables) : ""}`));
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
