// The menu of versions in the header. versions.js, beside the folders of the versions, lists them; it is a script because pages that are
// opened as files may not read other files. Without it there is no menu.
const here = document.currentScript.src;
const list = document.createElement("script");
list.src = new URL("../../versions.js", here).href;
list.onload = () => {
  const menu = document.createElement("select");
  menu.className = "versions";
  menu.setAttribute("aria-label", "Version");
  const current = decodeURIComponent(new URL("..", here).pathname.split("/").at(-2));
  for (const name of window.glbenchVersions) menu.add(new Option(name, name, name === current, name === current));
  menu.onchange = () => { location.href = new URL(`../../${menu.value}/index.html`, here).href; };
  document.querySelector(".md-header__title")?.after(menu);
};
document.head.append(list);
