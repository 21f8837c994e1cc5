// The curves of a drive follow its video; a click on a chart or an event moves the video there.
"use strict";
const data = JSON.parse(document.getElementById("curves").textContent);
const video = document.querySelector("video");
const figures = [...document.querySelectorAll("figure.curve")];
const last = data.times[data.times.length - 1] || 1;

function show(time) {
  let row = 0;
  // The video shows a state until the next one: its image stays until the stamp of the next.
  while (row + 1 < data.times.length && data.times[row + 1] <= time + 1e-3) row += 1;
  const x = data.left + (Math.min(time, last) / last) * (data.right - data.left);
  figures.forEach((figure, place) => {
    const curve = data.curves[place], value = curve.values[row], line = figure.querySelector(".now");
    figure.querySelector("output").textContent = value === null ? "none" : `${value.toFixed(curve.digits)} ${curve.unit}`;
    if (line) { line.setAttribute("x1", x); line.setAttribute("x2", x); }
  });
}

function move(time) {
  const inside = Math.min(Math.max(time, 0), last);
  if (video) { video.pause(); video.currentTime = inside + 1e-3; }
  show(inside);
}

for (const svg of document.querySelectorAll("figure.curve svg")) {
  const at = (event) => {
    const box = svg.getBoundingClientRect(), x = ((event.clientX - box.left) / box.width) * svg.viewBox.baseVal.width;
    move(((x - data.left) / (data.right - data.left)) * last);
  };
  svg.addEventListener("pointerdown", at);
  svg.addEventListener("pointermove", (event) => { if (event.buttons) at(event); });
}
for (const button of document.querySelectorAll(".events button")) button.addEventListener("click", () => move(Number(button.dataset.at)));
if (video) {
  const follow = () => { show(video.currentTime); if (!video.paused) requestAnimationFrame(follow); };
  video.addEventListener("play", follow);
  video.addEventListener("seeked", () => show(video.currentTime));
}
show(0);
