// The page: what comes from the server, what the user does, and when to draw.

import {Link} from "./link.js";
import {Memory} from "./memory.js";
import {HealthPanel, ObstacleTable} from "./panels.js";
import {Plots} from "./plots.js";
import {Road} from "./road.js";

const PLOT_MS = 150, SEEK_MS = 100, JUMP_S = 5;
const UNITS = [{factor: 1, name: "m/s"}, {factor: 3.6, name: "km/h"}];
const element = (id) => document.getElementById(id);

const memory = new Memory();
let stage = {sensors: [], states: [], classes: [], modes: [], session: null, live: false};
let state = {playing: true, follows: false, speed: 1, first: 0, last: 0, complete: false, cut: false, problem: ""};
let shown = 0, selected = null, status = null, health = null, skipped = 0, due = false, plotted = 0, sought = {}, held = false;
let wanted = deepLink();

const road = new Road(element("road"), memory, choose);
const table = new ObstacleTable(element("obstacles"), choose);
const plots = new Plots(element("plots"), memory);
const panel = new HealthPanel(element("figures"), element("sensors"), element("buses"));
const link = new Link(take, (open) => {
  element("link").textContent = open ? "connected" : "no connection to candaemon; trying again";
  element("link").classList.toggle("bad", !open);
});

function take(message) {
  if (message.type === "setup") setUp(message);
  if (message.state) state = message.state;
  if (message.type === "health") status = message.status;
  if (message.type === "pictures") {
    memory.add(message.pictures, message.afresh);
    shown = message.at;
    skipped += message.dropped;
    for (const picture of message.pictures) health = picture.health ?? health;
  }
  goWhereWanted();
  redraw();
}

// As soon as the log has been read so far; where it ends before, to its end.
function goWhereWanted() {
  if (wanted !== null && (state.complete || state.last >= wanted.from(state.first))) {
    link.say({do: "seek", t: Math.max(Math.min(wanted.from(state.first), state.last), state.first)});
    wanted = null;
  }
}

// A connection that opens again begins to play anew: go on as before, at a time of the beginning.
function goOn(from) {
  if (state.follows) return;
  wanted = {from};
  link.say({do: "speed", value: state.speed});
  if (!state.playing) link.say({do: "pause"});
}

function setUp(message) {
  const same = message.session === stage.session, [at, since] = [shown, shown - state.first];
  if (same && shown) goOn(() => at);
  else if (shown && !message.live && message.title === stage.title) goOn((first) => first + since);  // started again
  else wanted = deepLink();
  if (!same) {
    memory.clear();
    [health, status, skipped] = [null, null, 0];
    state = {...state, first: 0, last: 0, complete: false};
    road.fitted = false;
  }
  stage = road.stage = message;
  plots.modes = message.modes;
  element("title").textContent = `${message.name}: ${message.title}`;
  document.title = `${message.name} – candaemon view`;
  element("follow").hidden = !message.live;
  const marks = [...message.states.map((name) => [name, name, ""]), ["lost just now", "lost", ""],
    ...message.sensors.map((sensor, k) => [`${sensor.name} (${sensor.kind})`, `sensor-${k % 6}`, "sensor"])];
  element("legend").replaceChildren(...marks.map(([text, colour, kind]) => {
    const mark = Object.assign(document.createElement("li"), {textContent: text, className: kind});
    mark.style.setProperty("--mark", `var(--${colour})`);
    return mark;
  }));
  if (!road.fitted) road.fit();
  choose(selected);
}

// As often as the screen is, however often the server tells something.
function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame((now) => {
    due = false;
    road.draw();
    const picture = memory.latest;
    table.show(picture, stage, selected);
    element("count").textContent = picture ? picture.obstacles.id.length : 0;
    element("origin").textContent = picture ? (picture.heard ? "from the bus" : "tracked here") : "";
    document.documentElement.dataset.pictures = memory.pictures.length;
    if (now - plotted > PLOT_MS) {
      plotted = now;
      plots.update();
      panel.show(health, status, skipped);
    }
    showControls();
  });
}

function showControls() {
  element("play").textContent = state.playing ? "Pause" : "Play";
  element("play").setAttribute("aria-pressed", !state.playing);
  element("follow").setAttribute("aria-pressed", state.follows);
  const notice = state.problem || (state.cut ? "The drive goes on, but no more of it can be kept: cut the log" : "");
  element("notice").textContent = notice;
  element("notice").hidden = !notice;
  const seek = element("seek");
  seek.max = Math.max(state.last - state.first, 0.001);
  if (!held) seek.value = shown - state.first;
  const more = state.complete || stage.live ? "" : " …";
  element("time").textContent = state.last ? `${Math.max(shown - state.first, 0).toFixed(2)} / ${(state.last - state.first).toFixed(1)} s${more}` : "waiting";
  const speed = element("speed"), text = String(state.speed);
  if (![...speed.options].some((option) => option.value === text)) speed.add(new Option(text, text));
  if (document.activeElement !== speed) speed.value = text;
}

function choose(id) {
  selected = road.selected = id;
  element("selected-title").textContent = id === null ? "No obstacle selected" : `Obstacle ${id}`;
  plots.make(id);
  redraw();
}

function chooseNext(step) {
  const ids = memory.latest ? [...memory.latest.rowOf.keys()].sort((a, b) => a - b) : [];
  if (!ids.length) return choose(null);
  const here = ids.indexOf(selected);
  choose(ids[(here < 0 ? (step > 0 ? 0 : ids.length - 1) : here + step + ids.length) % ids.length]);
}

function seekTo(time) {
  wanted = null;
  const now = performance.now();
  clearTimeout(sought.timer);
  const go = () => {
    sought = {at: performance.now()};
    link.say({do: "seek", t: time});
  };
  if (now - (sought.at ?? 0) >= SEEK_MS) go();
  else sought = {at: sought.at, timer: setTimeout(go, SEEK_MS)};
}

function changeSpeed(step) {
  const speeds = [...element("speed").options].map((option) => Number(option.value)).sort((a, b) => a - b);
  const next = step > 0 ? speeds.find((speed) => speed > state.speed) : speeds.findLast((speed) => speed < state.speed);
  if (next) link.say({do: "speed", value: next});
}

function changeUnit() {
  const unit = UNITS[(UNITS.indexOf(road.unit) + 1) % UNITS.length] ?? UNITS[0];
  setUnit(unit);
  localStorage.setItem("unit", unit.name);
}

function setUnit(unit) {
  road.unit = plots.unit = unit;
  table.setUnit(unit);
  element("units").textContent = unit.name;
  choose(selected);
}

function setTheme(theme) {
  if (theme) document.documentElement.dataset.theme = theme;
  road.readColours();
  choose(selected);
}

function changeTheme() {
  const dark = getComputedStyle(document.documentElement).colorScheme === "dark";
  const theme = dark ? "light" : "dark";
  localStorage.setItem("theme", theme);
  setTheme(theme);
}

// #t=12.5 (s from the beginning) or #t=1533226503.4 (as in the log); #id=33 selects.
function deepLink() {
  const hash = new URLSearchParams(location.hash.slice(1));
  if (hash.has("id")) selected = Number(hash.get("id"));
  const time = Number(hash.get("t"));
  if (!hash.has("t") || !Number.isFinite(time)) return null;
  return {from: (first) => (time < 1e6 ? first + time : time)};
}

addEventListener("hashchange", () => {
  wanted = deepLink();
  choose(selected);
  goWhereWanted();
});

const togglePlay = () => link.say({do: state.playing ? "pause" : "play"});
const KEYS = [
  [[" ", "k"], "space", "play or pause", togglePlay],
  [[","], ",", "one picture back", () => link.say({do: "step", by: -1})],
  [["."], ".", "one picture on", () => link.say({do: "step", by: 1})],
  [["ArrowLeft"], "←", `${JUMP_S} s back`, () => seekTo(shown - JUMP_S)],
  [["ArrowRight"], "→", `${JUMP_S} s on`, () => seekTo(shown + JUMP_S)],
  [["Home"], "Home", "to the beginning", () => seekTo(state.first)],
  [["End"], "End", "to the end", () => seekTo(state.last)],
  [["["], "[", "slower", () => changeSpeed(-1)],
  [["]"], "]", "faster", () => changeSpeed(1)],
  [["l"], "l", "live: the newest picture", () => link.say({do: "follow"})],
  [["n"], "n", "select the next obstacle", () => chooseNext(1)],
  [["p"], "p", "select the one before", () => chooseNext(-1)],
  [["Escape"], "Esc", "select none", () => choose(null)],
  [["+", "="], "+", "nearer", () => road.zoom(1.25)],
  [["-"], "−", "farther", () => road.zoom(0.8)],
  [["0"], "0", "show all of it", () => road.fit()],
  [["w"], "w", "move the view up", () => road.pan(0, 60)],
  [["s"], "s", "move the view down", () => road.pan(0, -60)],
  [["a"], "a", "move the view left", () => road.pan(60, 0)],
  [["f"], "f", "move the view right", () => road.pan(-60, 0)],
  [["u"], "u", "m/s or km/h", changeUnit],
  [["d"], "d", "dark or light", changeTheme],
  [["g"], "g", "show or hide the legend", () => { element("colours").open = !element("colours").open; }],
  [["?", "h"], "?", "these keys", () => element("help").showModal()],
];

element("keys").replaceChildren(...KEYS.flatMap(([, name, about]) => [
  Object.assign(document.createElement("dt"), {textContent: name}),
  Object.assign(document.createElement("dd"), {textContent: about})]));

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || element("help").open) return;
  if (event.target instanceof HTMLSelectElement || (event.key === " " && event.target instanceof HTMLButtonElement)) return;
  const found = KEYS.find(([keys]) => keys.includes(event.key));
  if (!found) return;
  event.preventDefault();
  found[3]();
});

element("play").onclick = togglePlay;
element("back").onclick = () => link.say({do: "step", by: -1});
element("forth").onclick = () => link.say({do: "step", by: 1});
element("follow").onclick = () => link.say({do: "follow"});
element("zoom-in").onclick = () => road.zoom(1.25);
element("zoom-out").onclick = () => road.zoom(0.8);
element("zoom-fit").onclick = () => road.fit();
element("theme").onclick = changeTheme;
element("units").onclick = changeUnit;
element("help-open").onclick = () => element("help").showModal();
element("speed").onchange = (event) => link.say({do: "speed", value: Number(event.target.value)});
element("seek").oninput = (event) => {
  held = true;
  seekTo(state.first + Number(event.target.value));
};
element("seek").onchange = (event) => {
  held = false;
  seekTo(state.first + Number(event.target.value));
};
for (const end of ["pointerup", "pointercancel", "blur"]) {  // back where it began, it does not change
  element("seek").addEventListener(end, () => { held = false; });
}
element("colours").open = !matchMedia("(max-width: 900px)").matches;  // where it would cover much of the road
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => setTheme(null));
setTheme(localStorage.getItem("theme"));
setUnit(UNITS.find((unit) => unit.name === localStorage.getItem("unit")) ?? UNITS[0]);
