// What a baseline was set to, and how it was trained.

const settingsTables = (sections, file) => sections.map(([title, words, rows]) =>
  plainTable([title || file.split("/").at(-1), words].filter(Boolean).join(": "), ["Setting", "Value", "Unit", "Meaning"], rows, [0, 2, 3]));

const settingsPart = (result) => {
  if (result.settings === null || result.settings === undefined) return null;
  const { title, description, file, sections, training } = D.settings[result.settings], task = TASKS[result.task];
  const curve = training?.curve ?? [], score = wordsOf(task).metric[SCORE], named = [score.label, score.unit].filter(Boolean).join(", ");
  // What was learnt lies far above the beginning: the scale begins where the last nine tenths do.
  const shown = curve.slice(Math.floor(curve.length / 10)).map(([, value]) => value), room = 0.06 * (Math.max(...shown) - Math.min(...shown) || 1);
  return h("section", { id: "settings" },
    h("h2", {}, "Its settings"),
    h("p", {}, h("b", {}, title), ". ", description),
    sections.length ? [h("p", { class: "small soft" }, "From ", h("code", {}, file), "; copy the folder, change the copy and evaluate its path to try others."), h("div", { class: "settings" }, settingsTables(sections, file))] : null,
    training ? [
      h("h3", {}, "How it was trained"), h("p", { class: "small soft" }, "From ", h("code", {}, training.file), ", as its makers wrote it."),
      h("div", { class: "grid two" },
        plainTable("Training", ["", ""], training.rows, [0, 1]),
        curve.length > 1 ? chart(captionOf("Learning curve", `${named}, of what was tried at that point`), () => ({
          traces: [line(curve.map(([steps]) => steps / 1e6), curve.map(([, value]) => value), colourOf(result.agent), { mode: "lines+markers", marker: { size: 4 }, hovertemplate: `%{y:,.${score.decimals + 1}f}<extra></extra>` })],
          layout: layout({ xaxis: { title: axisTitle("million control steps") }, yaxis: { title: axisTitle(named), range: [Math.min(...shown) - room, Math.max(...curve.map(([, value]) => value)) + room] } }),
        }), { height: 240, says: `Learning curve: from ${number(curve[0][1], 2)} to ${number(curve.at(-1)[1], 2)} after ${number(curve.at(-1)[0], 0)} control steps.` }) : null),
      training.recipe.length ? h("details", { class: "data" }, h("summary", {}, "The recipe of the training, ", h("code", {}, training.recipe_file)), h("div", { class: "settings" }, settingsTables(training.recipe, training.recipe_file))) : null,
    ] : null);
};
