// Tables of a report: filters, sorting, CSV and JSON of what is shown, the where() line; images enlarge on a click.
"use strict";
const PAGE = 200;

function cell(value) {
  if (value === null || value === undefined) return "--";
  if (Array.isArray(value)) return value.join(" ");
  return typeof value === "number" && !Number.isInteger(value) ? value.toFixed(2) : String(value);
}

function csv(columns, rows) {
  const quote = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const lines = rows.map((row) => row.map((value) => quote(value === null ? "" : Array.isArray(value) ? value.join(" ") : String(value))).join(","));
  return [columns.join(","), ...lines].join("\n") + "\n";
}

function save(name, type, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

function makeTable(section) {
  const data = JSON.parse(section.querySelector("script").textContent);
  const head = section.querySelector("thead"), body = section.querySelector("tbody"), about = section.querySelector(".about");
  const line = section.querySelector(".where"), more = section.querySelector(".more");
  const state = { column: null, down: false, shown: PAGE, chosen: {} };
  const numeric = data.columns.map((_, place) => data.rows.some((row) => typeof row[place] === "number"));

  for (const name of data.filters) {
    const place = data.columns.indexOf(name), label = document.createElement("label"), select = document.createElement("select");
    const values = [...new Set(data.rows.map((row) => cell(row[place])))].sort();
    for (const value of ["all", ...values]) select.append(new Option(value, value));
    select.name = name;
    select.onchange = () => { state.chosen[name] = select.value === "all" ? undefined : select.value; state.shown = PAGE; draw(); };
    label.append(name.replaceAll("_", " ") + " ", select);
    section.querySelector(".filters").append(label);
  }
  const titles = document.createElement("tr");
  data.columns.forEach((name, place) => {
    const title = document.createElement("th"), button = document.createElement("button");
    if (numeric[place]) title.className = "n";
    button.textContent = name.replaceAll("_", " ");
    button.onclick = () => { state.down = state.column === place && !state.down; state.column = place; draw(); };
    title.append(button);
    titles.append(title);
  });
  head.append(titles);

  function chosenRows() {
    let rows = data.rows.filter((row) => data.filters.every((name) => state.chosen[name] === undefined || cell(row[data.columns.indexOf(name)]) === state.chosen[name]));
    if (state.column !== null) {
      const sign = state.down ? -1 : 1, at = state.column;
      rows = [...rows].sort((a, b) => sign * (numeric[at] ? (a[at] ?? -Infinity) - (b[at] ?? -Infinity) : cell(a[at]).localeCompare(cell(b[at]))));
    }
    return rows;
  }

  function draw() {
    const rows = chosenRows();
    body.replaceChildren(...rows.slice(0, state.shown).map((row) => {
      const line = document.createElement("tr");
      row.forEach((value, place) => {
        const item = document.createElement("td");
        item.dataset.head = data.columns[place].replaceAll("_", " ");
        if (numeric[place]) item.className = "n";
        if (data.columns[place] === "scene" && data.pages && data.pages[value]) {
          const link = document.createElement("a");
          link.href = data.pages[value];
          link.textContent = value;
          item.append(link);
        } else item.textContent = cell(value);
        line.append(item);
      });
      return line;
    }));
    [...titles.children].forEach((title, place) => title.setAttribute("aria-sort", place !== state.column ? "none" : state.down ? "descending" : "ascending"));
    about.textContent = `${rows.length.toLocaleString("en")} of ${data.rows.length.toLocaleString("en")} rows`;
    more.hidden = rows.length <= state.shown;
    const words = Object.entries(state.chosen).filter(([name, value]) => value !== undefined && data.where.includes(name)).map(([name, value]) => `${name}=${JSON.stringify(value)}`);
    line.textContent = data.where.length ? (words.length ? `dataset.where(${words.join(", ")})` : "dataset") : "";
  }
  more.onclick = () => { state.shown += PAGE; draw(); };
  section.querySelector(".csv").onclick = () => save(`${data.name}.csv`, "text/csv", csv(data.columns, chosenRows()));
  section.querySelector(".json").onclick = () => save(`${data.name}.json`, "application/json", JSON.stringify(chosenRows().map((row) => Object.fromEntries(row.map((value, place) => [data.columns[place], value])))));
  draw();
}

document.querySelectorAll("section.table").forEach(makeTable);
const dialog = document.querySelector("dialog");
if (dialog) {
  document.querySelectorAll(".shot img").forEach((image) => {
    image.tabIndex = 0;
    const open = () => { dialog.replaceChildren(Object.assign(new Image(), { src: image.src, alt: image.alt })); dialog.showModal(); };
    image.onclick = open;
    image.onkeydown = (event) => { if (event.key === "Enter") open(); };
  });
  dialog.onclick = () => dialog.close();
}
