const data = JSON.parse(document.getElementById("data").textContent);
const items = data.items, find = id => document.getElementById(id);
let at = items.findIndex(item => !item.verdict);
if (at < 0) at = 0;
function show() {
  const item = items[at], done = items.filter(one => one.verdict).length;
  find("image").src = "/image/" + item.sha256 + "?token=" + data.token;
  const rest = done < items.length ? done + " reviewed" : "all are reviewed: end the command with Ctrl-C";
  find("place").textContent = "image " + (at + 1) + " of " + items.length + ", " + rest;
  find("name").textContent = item.name;
  find("verdict").textContent = item.verdict && "answer: " + item.verdict;
  find("verdict").className = item.verdict;
  // Small images are enlarged: a missed face of 10 px must be seen.
  find("stage").style.width = "min(100%, " + 76 * item.width / item.height + "vh)";
  const svg = find("regions");
  svg.setAttribute("viewBox", "0 0 " + item.width + " " + item.height);
  svg.replaceChildren(...item.regions.map(([kind, left, top, right, bottom]) => {
    const rect = document.createElementNS("http://www.w3.org/2000/svg", "rect");
    const u = item.grow * (right - left) / 2, v = item.grow * (bottom - top) / 2;
    rect.setAttribute("x", left - u); rect.setAttribute("y", top - v);
    rect.setAttribute("width", right - left + 2 * u); rect.setAttribute("height", bottom - top + 2 * v);
    rect.setAttribute("class", kind);
    return rect;
  }));
}
async function say(verdict) {
  const item = items[at];
  const answer = await fetch("/", {method: "POST", body: JSON.stringify({token: data.token, sha256: item.sha256, verdict})})
    .catch(() => null);
  if (!answer || !answer.ok) {
    find("verdict").textContent = "not written: is the command still running?";
    return;
  }
  item.verdict = verdict;
  if (at < items.length - 1) at += 1;
  show();
}
function back() { if (at > 0) at -= 1; show(); }
function toggle() { find("regions").style.display = find("regions").style.display ? "" : "none"; }
const keys = {n: () => say("ok"), m: () => say("miss"), f: () => say("false"), b: back, r: toggle};
document.addEventListener("keydown", event => {
  if (!event.ctrlKey && !event.metaKey && keys[event.key]) { event.preventDefault(); keys[event.key](); }
});
document.querySelectorAll("[data-verdict]").forEach(one => one.addEventListener("click", () => say(one.dataset.verdict)));
find("back").addEventListener("click", back);
find("toggle").addEventListener("click", toggle);
show();
