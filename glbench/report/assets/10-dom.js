// Elements, numbers and words.

const h = (tag, attributes = {}, ...children) => {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "style") for (const [key, one] of Object.entries(value)) element.style.setProperty(key, one);
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
};

const MINUS = "\u2212";
const number = (value, decimals, signed = false) => {
  if (value === null || !Number.isFinite(value)) return "\u2013";
  const text = Math.abs(value).toLocaleString("en", { minimumFractionDigits: decimals, maximumFractionDigits: decimals });
  const zero = Number(Math.abs(value).toFixed(decimals)) === 0;
  return (zero ? "" : value < 0 ? MINUS : signed ? "+" : "") + text;
};
const withUnit = (value, decimals, unit, signed = false) => number(value, decimals, signed) + (unit ? `\u00a0${unit}` : "");
// A name that may be broken after an underscore, and nowhere else.
const breakable = (name) => name.split(/(?<=_)/).flatMap((part, i) => (i ? [h("wbr"), part] : [part]));
const capital = (text) => text.charAt(0).toUpperCase() + text.slice(1);
const lower = (label) => label.toLowerCase().replace("co\u2082", "CO\u2082");
const plural = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;
const sentence = (words) => (words.length < 2 ? words.join("") : `${words.slice(0, -1).join(", ")} and ${words.at(-1)}`);
const date = (iso, day, options = { day: "numeric", month: "long" }) => {
  const moment = new Date(`${iso}T00:00:00Z`);
  moment.setUTCDate(moment.getUTCDate() + day);
  return moment.toLocaleDateString("en-GB", { ...options, timeZone: "UTC" });
};
// A day of runs: its date where all start on one day, else its number.
const dayOf = (start, day, options) => (start ? date(start, day, options) : `day ${day + 1}`);
const SHORT_DATE = { day: "numeric", month: "short" };
const clockHour = (hour) => `${String(hour).padStart(2, "0")}:00`;

// Text for plotly, which reads a little HTML: shown as it is written.
const plain = (text) => String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;");

const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
const sum = (values) => values.reduce((total, value) => total + value, 0);
