// Plots of the selected obstacle over the last seconds.

import {at, speedOf} from "./memory.js";

const HEIGHT = 92;
const LINES = ["sensor-0", "sensor-1", "sensor-2", "sensor-3", "sensor-4", "sensor-5"];

const POINTS = ["NIS", "innovation"];  // of several sensors, a cycle has them of those it saw: no two in a row

export class Plots {
  constructor(place, memory) {
    this.place = place;
    this.memory = memory;
    this.modes = [];
    this.unit = {factor: 1, name: "m/s"};
    this.id = null;
    this.plots = [];
    new ResizeObserver(() => {
      for (const {plot} of this.plots) plot.setSize({width: this.width(), height: HEIGHT});
    }).observe(place);
  }

  width() {
    return Math.max(this.place.clientWidth, 120);
  }

  // What is plotted: a title, and a quantity a line.
  sheets() {
    const quantity = (name) => (picture, row) => at(picture, name, row);
    const sheets = [
      ["range, m", [["range", (picture, row) => Math.hypot(at(picture, "x", row), at(picture, "y", row))]]],
      [`speed over ground, ${this.unit.name}`, [["speed", (picture, row) => speedOf(picture, row) * this.unit.factor]]],
      ["NIS over its degrees of freedom: 1 is expected", [["NIS", quantity("nis")]]],
      ["innovation, m", [["ahead", quantity("innovation_x")], ["left", quantity("innovation_y")]]],
    ];
    if (this.modes.length) {
      sheets.push(["model probabilities", this.modes.map((name, k) => [name, (picture, row) => picture.modes?.[row]?.[k] ?? null])]);
    } else {
      sheets.push(["existence", [["existence", quantity("existence")]]]);
    }
    return sheets;
  }

  // Begin afresh: another obstacle, colours or units.
  make(id) {
    for (const {plot} of this.plots) plot.destroy();
    this.plots = [];
    this.id = id;
    if (id === null) return;
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const axis = {stroke: colour("soft"), grid: {stroke: colour("line"), width: 1}, ticks: {show: false}, font: "10px system-ui"};
    for (const [title, lines] of this.sheets()) {
      const options = {
        title, width: this.width(), height: HEIGHT, legend: {show: false}, cursor: {show: false},
        scales: {x: {time: false}},
        axes: [{...axis, size: 18}, {...axis, size: 42}],
        series: [{}, ...lines.map(([label], k) => ({label, stroke: colour(LINES[k % LINES.length]), width: 1.5, spanGaps: false, points: {show: POINTS.some((each) => title.startsWith(each)), size: 3}}))],
      };
      if (lines.length > 1) options.title = `${title}: ${lines.map(([label]) => label).join(", ")}`;
      this.plots.push({plot: new uPlot(options, undefined, this.place), lines});
    }
    this.update();
  }

  update() {
    if (this.id === null || !this.memory.latest) return;
    for (const {plot, lines} of this.plots) {
      plot.setData(this.memory.series(this.id, lines.map(([, quantity]) => quantity)));
    }
  }
}
