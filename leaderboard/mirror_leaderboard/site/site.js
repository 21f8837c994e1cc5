"use strict";
for (const tabs of document.querySelectorAll(".tabs")) {
  const panels = [...tabs.querySelectorAll(".panel")];
  const notes = tabs.parentElement.querySelector(".notes");
  const moveNotes = (panel) => {
    if (notes === null) return;
    const marks = [...panel.querySelectorAll("table sup")].flatMap((mark) => mark.textContent.split(","));
    for (const note of notes.children) note.hidden = !marks.includes(String(note.value));
    panel.insertBefore(notes, panel.querySelector("figure"));
  };
  if (panels.length < 2) { moveNotes(panels[0]); continue; }
  const list = document.createElement("div");
  list.setAttribute("role", "tablist");
  list.setAttribute("aria-label", "Datasets");
  const buttons = panels.map((panel) => {
    const button = document.createElement("button");
    const kind = document.createElement("small");
    kind.textContent = panel.dataset.kind;
    button.type = "button";
    button.append(panel.dataset.tab, " ", kind);
    button.setAttribute("role", "tab");
    button.setAttribute("aria-controls", panel.id);
    panel.setAttribute("role", "tabpanel");
    panel.setAttribute("aria-label", panel.dataset.tab);
    list.append(button);
    return button;
  });
  const select = (chosen) => {
    buttons.forEach((button, place) => {
      button.setAttribute("aria-selected", place === chosen);
      button.tabIndex = place === chosen ? 0 : -1;
      panels[place].hidden = place !== chosen;
    });
    moveNotes(panels[chosen]);
  };
  buttons.forEach((button, place) => {
    button.addEventListener("click", () => select(place));
    button.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step === undefined) return;
      const next = (place + step + panels.length) % panels.length;
      select(next);
      buttons[next].focus();
      event.preventDefault();
    });
  });
  const follow = () => {
    const place = panels.findIndex((panel) => "#" + panel.id === location.hash);
    if (place >= 0) { select(place); panels[place].scrollIntoView(); }
  };
  tabs.prepend(list);
  select(0);
  follow();
  addEventListener("hashchange", follow);
}
for (const table of document.querySelectorAll("table.board")) {
  const heads = [...table.querySelectorAll("thead th")].filter((head) => head.querySelector("button"));
  const body = table.tBodies[0];
  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const was = head.getAttribute("aria-sort");
      const first = head.dataset.better === "higher" ? "descending" : "ascending";
      const now = was === null ? first : was === "ascending" ? "descending" : "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", now);
      const value = (row) => {
        const data = row.cells[column].dataset.value;
        if (data === undefined) return null;
        return head.classList.contains("n") ? Number(data) : data;
      };
      const sign = now === "ascending" ? 1 : -1;
      const rows = [...body.rows].sort((a, b) => {
        const x = value(a), y = value(b);
        // Rows without a value come last in both directions.
        if (x === null || y === null) return (x === null) - (y === null);
        return x < y ? -sign : x > y ? sign : 0;
      });
      body.append(...rows);
    });
  });
}
for (const slider of document.querySelectorAll(".slider")) {
  const views = JSON.parse(slider.querySelector("script").textContent);
  const [view, left, right] = slider.querySelectorAll("select");
  const stage = slider.querySelector(".stage"), range = slider.querySelector("input");
  const show = (select, side) => {
    const image = stage.querySelector("img." + side);
    image.src = views[view.selectedIndex].images[select.value];
    image.alt = select.value + ": " + views[view.selectedIndex].view;
    stage.querySelector(".name." + side).textContent = select.value;
  };
  const fill = (select, fallback) => {
    const names = Object.keys(views[view.selectedIndex].images), was = select.value;
    select.replaceChildren(...names.map((name) => new Option(name)));
    select.value = names.includes(was) ? was : names[Math.min(fallback, names.length - 1)];
  };
  const update = () => { fill(left, 0); fill(right, 1); show(left, "left"); show(right, "right"); };
  view.addEventListener("change", update);
  left.addEventListener("change", () => show(left, "left"));
  right.addEventListener("change", () => show(right, "right"));
  range.addEventListener("input", () => stage.style.setProperty("--at", range.value + "%"));
  update();
}
