// The table of obstacles and the panel of health.

import {at, speedOf, stands} from "./memory.js";

const number = (value, decimals) => (value === null || value === undefined ? "–" : value.toFixed(decimals));

export class ObstacleTable {
  constructor(table, chosen) {
    this.body = table.tBodies[0];
    this.rows = new Map();
    this.unit = {factor: 1, name: "m/s"};
    this.head = table.tHead.rows[0];
    this.body.addEventListener("click", (event) => {
      const row = event.target.closest("tr");
      if (row) chosen(Number(row.dataset.id));
    });
    this.setUnit(this.unit);
  }

  setUnit(unit) {
    this.unit = unit;
    const names = ["id", "state", "x m", "y m", `speed ${unit.name}`, "range m", "NIS", "± m", "class", "existence", "age s"];
    this.head.replaceChildren(...names.map((name) => Object.assign(document.createElement("th"), {textContent: name})));
  }

  show(picture, stage, selected) {
    const there = picture ? picture.rowOf : new Map();
    for (const [id, row] of this.rows) {
      if (!there.has(id)) {
        row.remove();
        this.rows.delete(id);
      }
    }
    for (const [id, k] of there) {
      let row = this.rows.get(id);
      if (!row) {
        row = this.body.insertRow();
        row.dataset.id = id;
        for (let cell = 0; cell < 11; cell++) row.insertCell();
        this.rows.set(id, row);
      }
      const value = (name) => at(picture, name, k), state = stage.states[value("state")] ?? "";
      const size = Math.hypot(value("sx") ?? NaN, value("sy") ?? NaN);
      const texts = [
        String(id), state, number(value("x"), 2), number(value("y"), 2), number(speedOf(picture, k) * this.unit.factor, 1),
        number(Math.hypot(value("x"), value("y")), 1), number(value("nis"), 2), Number.isNaN(size) ? "–" : size.toFixed(2),
        stands(picture, k) ? "standing" : (stage.classes[value("class")] ?? "–"), number(value("existence"), 2), number(value("age"), 1),
      ];
      texts.forEach((text, cell) => {
        const place = row.cells[cell];
        if (place.textContent !== text) place.textContent = text;
      });
      row.cells[1].dataset.state = state;
      row.setAttribute("aria-selected", id === selected);
    }
  }
}

export class HealthPanel {
  constructor(figures, sensors, buses) {
    this.figures = figures;
    this.sensors = sensors;
    this.buses = buses;
  }

  // local: what the view counts itself. status: the running service's own figures, null where there is none.
  show(local, status, dropped) {
    const figures = [];
    const milliseconds = (spread) => (spread?.count ? `${(1e3 * spread.p50).toFixed(1)} / ${(1e3 * spread.p99).toFixed(1)} ms` : "–");
    if (status) {
      const lost = Object.values(status.losses ?? {}).reduce((sum, count) => sum + count, 0);
      figures.push(
        ["service", `${status.service.name}, pid ${status.service.pid}`], ["own motion", status.own_motion.status],
        ["cycles/s", number(status.cycles.rate, 1)], ["lost", String(lost), lost > 0],
        ["cycle p50 / p99", milliseconds(status.cycle_time)], ["latency p50 / p99", milliseconds(status.latency)]);
    } else if (local) {
      figures.push(
        ["own motion", local.own_motion], ["cycles/s", number(local.cycles.rate, 1)], ["cycles", String(local.cycles.told)],
        ["frames lost", String(local.drops), local.drops > 0]);
    }
    if (local?.unheard) figures.push(["frames this view missed", String(local.unheard), true]);
    figures.push(["pictures skipped", String(dropped), false]);
    this.figures.replaceChildren(...figures.map(([name, text, bad]) => {
      const box = document.createElement("div");
      box.append(
        Object.assign(document.createElement("dt"), {textContent: name}),
        Object.assign(document.createElement("dd"), {textContent: text, className: bad ? "bad" : ""}));
      return box;
    }));
    const sensors = status ? Object.entries(status.sensors).map(([name, each]) => [
      name, each.lost ? "lost" : "ok", number(each.rate, 1), String(each.frames.used),
      String(Object.entries(each.frames).reduce((sum, [fate, count]) => (fate === "used" ? sum : sum + count), 0)),
      number(each.nis.ratio, 2)]) : Object.entries(local?.sensors ?? {}).map(([name, each]) => [
      name, each.rate > 0 ? "ok" : "–", number(each.rate, 1), String(each.used), String(each.dropped), number(each.nis, 2)]);
    fill(this.sensors, ["sensor", "state", "scans/s", "used", "dropped", "NIS/freedom"], sensors);
    const buses = status ? Object.entries(status.buses).map(([name, each]) => [
      name, each.up ? "up" : `down: ${each.error}`, number(each.rate, 0), String(each.received),
      String(Object.values(each.dropped).reduce((sum, count) => sum + count, 0))]) :
      Object.entries(local?.buses ?? {}).map(([name, each]) => [
        name, each.rate > 0 ? "up" : "–", number(each.rate, 0), String(each.received), String(each.short)]);
    fill(this.buses, ["bus", "state", "frames/s", "received", "dropped"], buses);
  }
}

function fill(table, names, rows) {
  table.tHead.rows[0].replaceChildren(...names.map((name) => Object.assign(document.createElement("th"), {textContent: name})));
  table.tBodies[0].replaceChildren(...rows.map((texts) => {
    const row = document.createElement("tr");
    for (const text of texts) row.insertCell().textContent = text;
    return row;
  }));
}
