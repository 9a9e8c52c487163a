// The pictures of the last seconds: the newest is drawn, the others give trails, plots and what was lost.

const LONGEST_S = 20, MOST = 2000;

export class Memory {
  constructor() {
    this.pictures = [];
  }

  clear() {
    this.pictures.length = 0;
  }

  get latest() {
    return this.pictures.at(-1);
  }

  add(pictures, afresh) {
    if (afresh) this.clear();
    for (const picture of pictures) this.pictures.push(prepared(picture));
    const latest = this.latest;
    if (!latest) return;
    let old = 0;
    while (latest.t - this.pictures[old].t > LONGEST_S) old++;
    if (old) this.pictures.splice(0, old);
    if (this.pictures.length > MOST) this.thin();
  }

  // Many sensors make more pictures than can be held: of the older half, those some time apart.
  thin() {
    const whole = this.pictures.length - MOST / 2, apart = LONGEST_S / (MOST / 2);
    let kept = -Infinity;
    this.pictures = this.pictures.filter(({t}, k) => {
      if (k < whole && t - kept < apart) return false;
      kept = t;
      return true;
    });
  }

  // Pictures of the last seconds, oldest first.
  *since(seconds) {
    const latest = this.latest;
    if (!latest) return;
    let first = this.pictures.length - 1;
    while (first > 0 && latest.t - this.pictures[first - 1].t <= seconds) first--;
    for (let k = first; k < this.pictures.length; k++) yield this.pictures[k];
  }

  // What was lost within the last seconds, of what had been confirmed: its last row, and how long ago that was.
  lost(seconds) {
    const found = new Map(), latest = this.latest;
    if (!latest) return found;
    for (const picture of this.since(seconds)) {
      for (const [id, row] of picture.rowOf) {
        if (!latest.rowOf.has(id) && picture.obstacles.state[row] > 0) found.set(id, {picture, row, age: latest.t - picture.t});
      }
    }
    return found;
  }

  // A quantity of one obstacle over time; null where it was not known.
  series(id, quantities) {
    const times = [], columns = quantities.map(() => []);
    for (const picture of this.pictures) {
      const row = picture.rowOf.get(id);
      times.push(picture.t - this.latest.t);
      quantities.forEach((quantity, k) => columns[k].push(row === undefined ? null : quantity(picture, row)));
    }
    return [times, ...columns];
  }
}

function prepared(picture) {
  const {id, x, y} = picture.obstacles;
  picture.rowOf = new Map(id.map((each, row) => [each, row]));
  picture.ground = id.map((_, row) => toGround(picture.pose, x[row], y[row]));
  picture.scans = picture.scans.map(([sensor, ids, xs, ys]) => (
    {sensor, ids, points: xs.map((each, k) => toGround(picture.pose, each, ys[k]))}));
  return picture;
}

// From vehicle axes at a pose to the ground, and back.
export function toGround(pose, x, y) {
  const c = Math.cos(pose[2]), s = Math.sin(pose[2]);
  return [pose[0] + c * x - s * y, pose[1] + s * x + c * y];
}

export function toVehicle(pose, [east, north]) {
  const c = Math.cos(pose[2]), s = Math.sin(pose[2]);
  const de = east - pose[0], dn = north - pose[1];
  return [c * de + s * dn, c * dn - s * de];
}

export const at = (picture, name, row) => picture.obstacles[name]?.[row] ?? null;

export const speedOf = (picture, row) => Math.hypot(at(picture, "vx", row) ?? 0, at(picture, "vy", row) ?? 0);

const STANDING_CLASS = 5, STANDING_SPEED = 0.5;

export const stands = (picture, row) => (
  at(picture, "class", row) === STANDING_CLASS || speedOf(picture, row) < STANDING_SPEED);
