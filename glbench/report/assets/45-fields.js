// What the reader chooses: a task, an agent, prices.

const select = (label, options, chosen, change, id) => h("div", { class: "field" }, h("label", { for: id }, label),
  h("select", { id, onchange: (event) => change(event.target.value) }, options.map((option) => {
    const item = ({ value, text }) => h("option", { value, selected: value === chosen }, text);
    return option.group ? h("optgroup", { label: option.group }, option.options.map(item)) : item(option);
  })));

const SUITE_WORDS = { paper: "As the paper describes it", "paper-code": "As the paper's code does it" };
const suiteTitle = (name) => SUITE_WORDS[name] ?? `Suite ${name}`;

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
  group: title, options: members.map((task) => ({ value: task.short, text: task.title })),
})), chosen, change, "choose-task");

const agentField = (label, chosen, change, names, id) => select(label, names.map((name) => ({ value: name, text: name })), chosen, change, id);

// Prices to try: whatever follows from amounts follows at once.
const priceField = (task, changed) => {
  if (!task.prices) return null;
  const prices = pricesOf(task), differ = pricesDiffer(task), { items } = wordsOf(task);
  const inputs = items.map(({ money: name, label, unit, least }) => h("div", { class: "field" },
    h("label", { for: `price-${name}` }, `${label}, ${unit}`),
    h("input", {
      id: `price-${name}`, type: "number", min: least, max: "100", step: least || "0.01", value: prices[name], inputmode: "decimal", required: true,
      onchange: (event) => {
        if (!event.target.checkValidity() && (event.target.validity.rangeUnderflow || event.target.validity.rangeOverflow || event.target.validity.valueMissing || event.target.validity.badInput)) { event.target.reportValidity(); return; }
        chosenPrices[task.words_of] = { ...chosenPrices[task.words_of], [name]: Number(event.target.value) };
        changed(`price-${name}`);
      },
    })));
  const words = differ
    ? items.filter(({ money }) => prices[money] !== task.prices[money]).map(({ money, label, unit }) => `${lower(label)} ${prices[money]} instead of ${task.prices[money]} ${unit}`)
    : [];
  return h("details", { class: `prices${differ ? " changed" : ""}`, id: "prices", open: pricesOpen, ontoggle: (event) => { pricesOpen = event.target.open; } },
    h("summary", {}, differ ? [h("b", {}, "Other prices: "), sentence(words)] : [h("b", {}, "What if prices were different?"), " Change them, and the ranking follows."]),
    h("form", { onsubmit: (event) => event.preventDefault() }, inputs,
      h("button", { class: "plain", type: "button", id: "reset-prices", disabled: !differ, onclick: () => { delete chosenPrices[task.words_of]; changed("reset-prices"); } }, "Back to the task\u2019s prices")),
    h("p", { class: "soft small" }, `Amounts stay as they were: the agents decided without knowing these prices. Profit and ${lower(wordsOf(task).metric[SCORE].label)} are computed again for every run, intervals by a bootstrap of 2,000 samples here in the page.${task.reward_modules.includes("scaled_epi") ? " The scale of the reward moves with the prices: compare rewards with each other, not with those before." : ""}`));
};
let pricesOpen = false;
