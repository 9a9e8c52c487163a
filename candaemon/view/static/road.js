// The bird's-eye view: x of the vehicle goes up the screen, y to the left.

import {at, speedOf, stands, toVehicle} from "./memory.js";

const TRAIL_S = 6, LOST_S = 1.5, MARK_S = 0.5, ARROW_S = 1, NEAREST = 1, FARTHEST = 60;
const CAR = {length: 4.5, width: 1.8};
const TAP_PX = 24;

export class Road {
  constructor(canvas, memory, chosen) {
    this.canvas = canvas;
    this.memory = memory;
    this.chosen = chosen;
    this.context = canvas.getContext("2d", {willReadFrequently: false});
    this.scale = 5; // px a metre
    this.origin = [0, 0]; // of the vehicle axes from the default place, px
    this.stage = {sensors: [], states: [], classes: []};
    this.unit = {factor: 1, name: "m/s"};
    this.selected = null;
    this.fitted = false;
    this.colours = {};
    this.readColours();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const names = ["road", "grid", "grid-ink", "view", "own", "ink", "tentative", "confirmed", "coasting", "lost", "chosen"];
    for (const name of [...names, ...Array.from({length: 6}, (_, k) => `sensor-${k}`)]) {
      this.colours[name] = style.getPropertyValue(`--${name}`).trim();
    }
    this.draw();
  }

  resize() {
    const ratio = devicePixelRatio || 1, {clientWidth, clientHeight} = this.canvas;
    this.canvas.width = Math.max(Math.round(clientWidth * ratio), 1);
    this.canvas.height = Math.max(Math.round(clientHeight * ratio), 1);
    if (!this.fitted) this.fit();
    this.draw();
  }

  // Show as far as the sensors see.
  fit() {
    const {clientWidth: width, clientHeight: height} = this.canvas;
    let far = 60, back = 15, side = 20;
    for (const sensor of this.stage.sensors) {
      for (const view of sensor.views) {
        const reach = Math.min(view.far, 130);
        far = Math.max(far, sensor.x + reach * Math.cos(view.yaw));
        back = Math.max(back, -(sensor.x + reach * Math.cos(view.yaw)));
        side = Math.max(side, Math.min(reach * Math.sin(Math.min(view.half, Math.PI / 2)), 45));
      }
    }
    this.scale = Math.min(Math.max(Math.min(height / (far + back), width / (2 * side)), NEAREST), FARTHEST);
    this.origin = [0, height / 2 - back * this.scale];
    this.fitted = width > 0;
    this.draw();
  }

  zoom(factor, x = this.canvas.clientWidth / 2, y = this.canvas.clientHeight / 2) {
    const scale = Math.min(Math.max(this.scale * factor, NEAREST), FARTHEST), [cx, cy] = this.centre();
    const grown = scale / this.scale;
    this.pan((cx - x) * (grown - 1), (cy - y) * (grown - 1), scale);
  }

  pan(dx, dy, scale = this.scale) {
    this.scale = scale;
    this.origin = [this.origin[0] + dx, this.origin[1] + dy];
    this.draw();
  }

  // Where the vehicle axes' origin is on the canvas, px of CSS.
  centre() {
    return [this.canvas.clientWidth / 2 + this.origin[0], this.canvas.clientHeight / 2 + this.origin[1]];
  }

  place(x, y) {
    const [cx, cy] = this.centre();
    return [cx - y * this.scale, cy - x * this.scale];
  }

  draw() {
    const context = this.context, ratio = devicePixelRatio || 1, {clientWidth: width, clientHeight: height} = this.canvas;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.globalAlpha = 1;
    context.fillStyle = this.colours.road;
    context.fillRect(0, 0, width, height);
    this.drawGrid(width, height);
    this.drawViews();
    const picture = this.memory.latest;
    this.drawOwn();
    if (picture) {
      this.drawTrails(picture);
      this.drawDetections(picture);
      this.drawLost(picture);
      for (let row = 0; row < picture.obstacles.id.length; row++) this.drawObstacle(picture, row);
      this.drawLabels(picture);
      for (let row = 0; row < picture.obstacles.id.length; row++) this.drawReference(picture, row);
    }
    const [cx, cy] = this.centre();
    Object.assign(this.canvas.dataset, {scale: this.scale, cx, cy, time: picture ? picture.t : ""});
  }

  // Lines over ground every 10 m or so, which move past as the vehicle moves, and rings of range.
  drawGrid(width, height) {
    const context = this.context, pose = this.memory.latest?.pose ?? [0, 0, 0];
    const step = [1, 2, 5, 10, 20, 50, 100].find((each) => each * this.scale >= 45) ?? 200;
    const [cx, cy] = this.centre();
    context.strokeStyle = this.colours.grid;
    context.lineWidth = 1;
    const reach = Math.hypot(Math.max(cx, width - cx), Math.max(cy, height - cy)) / this.scale;
    const first = (value) => Math.ceil((value - reach) / step) * step;
    context.beginPath();
    for (const axis of [0, 1]) {
      for (let line = first(pose[axis]); line <= pose[axis] + reach; line += step) {
        const ends = [-reach, reach].map((along) => {
          const ground = axis ? [pose[0] + along, line] : [line, pose[1] + along];
          return this.place(...toVehicle(pose, ground));
        });
        context.moveTo(...ends[0]);
        context.lineTo(...ends[1]);
      }
    }
    context.stroke();
    context.fillStyle = this.colours["grid-ink"];
    context.font = "11px system-ui, sans-serif";
    context.setLineDash([2, 4]);
    const ring = 2 * step;
    for (let range = ring; range <= reach && range / ring < 40; range += ring) {
      context.beginPath();
      context.arc(cx, cy, range * this.scale, 0, 2 * Math.PI);
      context.stroke();
      context.fillText(`${range} m`, cx + 4, cy - range * this.scale - 3);
    }
    context.setLineDash([]);
  }

  drawViews() {
    const context = this.context;
    this.stage.sensors.forEach((sensor, k) => {
      const [x, y] = this.place(sensor.x, sensor.y);
      context.strokeStyle = context.fillStyle = this.colours[`sensor-${k % 6}`];
      for (const view of sensor.views) {
        // a direction to the left of the vehicle is one against the clock on the screen, from up
        const middle = -Math.PI / 2 - view.yaw;
        context.beginPath();
        context.arc(x, y, view.far * this.scale, middle - view.half, middle + view.half);
        context.arc(x, y, view.near * this.scale, middle + view.half, middle - view.half, true);
        context.closePath();
        context.globalAlpha = 0.05;
        context.fill();
        context.globalAlpha = 0.4;
        context.stroke();
      }
    });
    context.globalAlpha = 1;
  }

  // The own vehicle: the rear axle's centre is the origin, the front a metre ahead of the front axle.
  drawOwn() {
    const context = this.context, [x, y] = this.place(3.7, 0.9), length = 4.7 * this.scale, width = 1.8 * this.scale;
    context.fillStyle = this.colours.own;
    context.globalAlpha = 0.85;
    context.beginPath();
    context.roundRect(x, y, width, length, Math.min(6, 0.4 * this.scale));
    context.fill();
    context.globalAlpha = 1;
    context.fillStyle = this.colours.road;
    context.fillRect(x + 0.2 * width, y + 0.25 * length, 0.6 * width, 0.14 * length);
  }

  drawTrails(picture) {
    const context = this.context, paths = new Map();
    for (const earlier of this.memory.since(TRAIL_S)) {
      for (const [id, row] of earlier.rowOf) {
        if (!picture.rowOf.has(id)) continue;
        if (!paths.has(id)) paths.set(id, []);
        paths.get(id).push(this.place(...toVehicle(picture.pose, earlier.ground[row])));
      }
    }
    context.lineWidth = 1.5;
    context.globalAlpha = 0.45;
    for (const [id, points] of paths) {
      context.strokeStyle = id === this.selected ? this.colours.chosen : this.stateColour(picture, picture.rowOf.get(id));
      context.beginPath();
      points.forEach((point, k) => (k ? context.lineTo(...point) : context.moveTo(...point)));
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  drawDetections(picture) {
    const context = this.context;
    for (const earlier of this.memory.since(MARK_S)) {
      const fade = 1 - (picture.t - earlier.t) / MARK_S;
      context.globalAlpha = 0.15 + 0.75 * fade * fade;
      for (const scan of earlier.scans) {
        context.fillStyle = this.colours[`sensor-${scan.sensor % 6}`];
        for (const point of scan.points) {
          const [x, y] = this.place(...toVehicle(picture.pose, point));
          context.beginPath();
          context.arc(x, y, 2.2, 0, 2 * Math.PI);
          context.fill();
        }
      }
    }
    context.globalAlpha = 1;
  }

  drawLost(picture) {
    const context = this.context;
    context.strokeStyle = context.fillStyle = this.colours.lost;
    context.lineWidth = 2;
    context.font = "11px system-ui, sans-serif";
    for (const [id, last] of this.memory.lost(LOST_S)) {
      const [x, y] = this.place(...toVehicle(picture.pose, last.picture.ground[last.row]));
      context.globalAlpha = Math.max(1 - last.age / LOST_S, 0.1);
      context.beginPath();
      context.moveTo(x - 6, y - 6);
      context.lineTo(x + 6, y + 6);
      context.moveTo(x + 6, y - 6);
      context.lineTo(x - 6, y + 6);
      context.stroke();
      context.fillText(`${id} lost`, x + 9, y + 4);
    }
    context.globalAlpha = 1;
  }

  stateColour(picture, row) {
    return this.colours[this.stage.states[at(picture, "state", row)] ?? "confirmed"] ?? this.colours.ink;
  }

  drawObstacle(picture, row) {
    const context = this.context, colour = this.stateColour(picture, row);
    const value = (name) => at(picture, name, row);
    const [x, y] = this.place(value("x"), value("y"));
    const known = value("length") !== null && value("width") !== null && value("length") > 0 && value("width") > 0;
    const length = known ? value("length") : CAR.length, width = known ? value("width") : CAR.width;
    const course = stands(picture, row) ? 0 : Math.atan2(value("vy"), value("vx"));
    const heading = value("heading") ?? course;
    // of unknown size: the reference point is taken as the middle of its near side
    let [px, py] = [value("center_x") ?? value("x"), value("center_y") ?? value("y")];
    if (!known) {
      const behind = px >= 0 ? 1 : -1;
      px += (behind * length) / 2;
    }
    const [bx, by] = this.place(px, py);
    context.save();
    context.translate(bx, by);
    context.rotate(-heading);
    context.strokeStyle = colour;
    context.lineWidth = 1.5;
    context.fillStyle = colour;
    context.globalAlpha = stands(picture, row) ? 0.06 : 0.2;
    const box = [(-width / 2) * this.scale, (-length / 2) * this.scale, width * this.scale, length * this.scale];
    context.fillRect(...box);
    context.globalAlpha = known ? 1 : 0.6;
    context.setLineDash(known ? [] : [3, 3]);
    context.strokeRect(...box);
    context.setLineDash([]);
    if (stands(picture, row)) { // crossed out: it stands
      context.beginPath();
      context.moveTo(box[0], box[1]);
      context.lineTo(box[0] + box[2], box[1] + box[3]);
      context.moveTo(box[0] + box[2], box[1]);
      context.lineTo(box[0], box[1] + box[3]);
      context.globalAlpha = 0.4;
      context.stroke();
    }
    context.restore();
    if (value("id") === this.selected) {
      context.strokeStyle = this.colours.chosen;
      context.lineWidth = 2.5;
      context.beginPath();
      context.arc(bx, by, Math.max((length * this.scale) / 2 + 5, 16), 0, 2 * Math.PI);
      context.stroke();
    }
    this.drawEllipse(x, y, value("sx"), value("sy"), value("sxy") ?? 0);
    this.drawArrow(x, y, value("vx"), value("vy"), colour);
  }

  // Three standard deviations of the place.
  drawEllipse(x, y, sx, sy, sxy) {
    if (sx === null || sy === null) return;
    const a = sx * sx, d = sy * sy, mean = (a + d) / 2, root = Math.hypot((a - d) / 2, sxy);
    const context = this.context;
    context.strokeStyle = this.colours.ink;
    context.lineWidth = 1;
    context.globalAlpha = 0.6;
    context.beginPath();
    // the larger axis lies along the angle from x, which is up, to y, which is left
    const angle = -Math.PI / 2 - 0.5 * Math.atan2(2 * sxy, a - d);
    const limit = 60 * this.scale;
    context.ellipse(
      x, y, Math.min(3 * Math.sqrt(mean + root) * this.scale, limit),
      Math.min(3 * Math.sqrt(Math.max(mean - root, 0)) * this.scale, limit), angle, 0, 2 * Math.PI);
    context.stroke();
    context.globalAlpha = 1;
  }

  drawArrow(x, y, vx, vy, colour) {
    const speed = Math.hypot(vx, vy);
    if (!(speed > 0.5)) return;
    const context = this.context, length = speed * ARROW_S * this.scale, angle = Math.atan2(-vx, -vy);
    context.save();
    context.translate(x, y);
    context.rotate(angle);
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(length, 0);
    context.stroke();
    context.beginPath();
    context.moveTo(length + 5, 0);
    context.lineTo(length - 4, -4);
    context.lineTo(length - 4, 4);
    context.fill();
    context.restore();
  }

  drawLabels(picture) {
    const context = this.context;
    context.font = "600 11px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.lineWidth = 3;
    context.strokeStyle = this.colours.road;
    for (let row = 0; row < picture.obstacles.id.length; row++) {
      const [x, y] = this.place(at(picture, "x", row), at(picture, "y", row));
      const id = at(picture, "id", row), speed = speedOf(picture, row) * this.unit.factor;
      const text = `${id}  ${stands(picture, row) ? "stands" : speed.toFixed(1)}`;
      context.fillStyle = id === this.selected ? this.colours.chosen : this.colours.ink;
      context.strokeText(text, x + 10, y + 10);
      context.fillText(text, x + 10, y + 10);
    }
    context.textBaseline = "alphabetic";
  }

  drawReference(picture, row) {
    const [x, y] = this.place(at(picture, "x", row), at(picture, "y", row));
    this.context.fillStyle = this.stateColour(picture, row);
    this.context.fillRect(x - 3, y - 3, 6, 6);
  }

  // The obstacle nearest to a point of the canvas, null where there is none near.
  nearest(x, y) {
    const picture = this.memory.latest;
    let best = null, least = TAP_PX;
    for (const [id, row] of picture?.rowOf ?? []) {
      const [px, py] = this.place(at(picture, "x", row), at(picture, "y", row));
      const distance = Math.hypot(px - x, py - y);
      if (distance < least) [best, least] = [id, distance];
    }
    return best;
  }

  listen() {
    const canvas = this.canvas, fingers = new Map();
    let moved = 0;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
      if (fingers.size === 1) moved = 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const point = [event.offsetX, event.offsetY];
      moved += Math.hypot(point[0] - before[0], point[1] - before[1]);
      const others = [...fingers].filter(([id]) => id !== event.pointerId);
      if (others.length === 1) {
        const [, other] = others[0];
        const apart = (each) => Math.max(Math.hypot(each[0] - other[0], each[1] - other[1]), 1);
        this.zoom(apart(point) / apart(before), (point[0] + other[0]) / 2, (point[1] + other[1]) / 2);
      } else if (moved > 4) {
        this.pan(point[0] - before[0], point[1] - before[1]);
      }
      fingers.set(event.pointerId, point);
    });
    const up = (event) => {
      if (fingers.delete(event.pointerId) && moved <= 4 && event.type === "pointerup") {
        this.chosen(this.nearest(event.offsetX, event.offsetY));
      }
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    }, {passive: false});
  }
}
