// The town from above, on a canvas.
import { decisionAt, poseAt } from "./timeline.js";

const LENGTH = 4.6;
const WIDTH = 1.9;
const AROUND = 12; // metres round what is to be seen
const FOLLOWED = 70; // metres across, around a car that is followed
const PEDESTRIAN = 1; // metres; who is shorter walks

/** Return the outline of a GeoJSON polygon or multipolygon. */
function outline(geometry) {
  const path = new Path2D();
  const parts = geometry.type === "Polygon" ? [geometry.coordinates] : geometry.coordinates;
  for (const ring of parts.flat()) {
    ring.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
    path.closePath();
  }
  return path;
}

/** The shapes of a town, and the direction in which the map points up. */
export class Town {
  /**
   * @param {object} detail the reply of GET /v1/towns/{town}
   * @param {string} approach its lane leads up; null: north is up
   */
  constructor(detail, approach) {
    const found = detail.approaches.find(({ id }) => id === approach);
    this.road = outline(detail.road);
    this.junctions = Object.values(detail.junctions).map(outline);
    this.lanes = new Path2D();
    for (const lane of Object.values(detail.lanes)) {
      lane.forEach(([x, y], i) => (i ? this.lanes.lineTo(x, y) : this.lanes.moveTo(x, y)));
    }
    this.stopLine = found && { at: found.stop_line, heading: found.heading };
    this.up = found ? found.heading : Math.PI / 2;
  }

  /** Return a point as metres to the right and upwards on the map. */
  turned(x, y) {
    const [cos, sin] = [Math.cos(this.up), Math.sin(this.up)];
    return [sin * x - cos * y, cos * x + sin * y];
  }
}

/** Return the part of the map with all places of the drives: its middle and its size, metres. */
export function whole(town, drives) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  const include = (x, y) => {
    const [right, up] = town.turned(x, y);
    box[0] = Math.min(box[0], right);
    box[1] = Math.min(box[1], up);
    box[2] = Math.max(box[2], right);
    box[3] = Math.max(box[3], up);
  };
  for (const drive of drives) drive.x.forEach((x, i) => include(x, drive.y[i]));
  if (town.stopLine) include(...town.stopLine.at);
  return {
    middle: [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2],
    size: [box[2] - box[0] + 2 * AROUND, box[3] - box[1] + 2 * AROUND],
  };
}

/** Return the corner of a map in which a box of the camera's size hides the fewest places of the drives. */
export function freeCorner(town, drives, view, map, box) {
  const scale = Math.min(map.clientWidth / view.size[0], map.clientHeight / view.size[1]); // pixels a metre
  const margin = LENGTH * scale;
  const hidden = { "low-right": 0, "high-right": 0, "low-left": 0 };
  for (const drive of drives) {
    drive.x.forEach((x, i) => {
      const [right, up] = town.turned(x, drive.y[i]);
      const [across, down] = [map.clientWidth / 2 + scale * (right - view.middle[0]), map.clientHeight / 2 - scale * (up - view.middle[1])];
      const atRight = across > map.clientWidth - box.clientWidth - margin;
      const low = down > map.clientHeight - box.clientHeight - margin;
      hidden["low-right"] += atRight && low;
      hidden["high-right"] += atRight && down < box.clientHeight + margin;
      hidden["low-left"] += across < box.clientWidth + margin && low;
    });
  }
  return Object.keys(hidden).reduce((best, corner) => (hidden[corner] < hidden[best] ? corner : best));
}

/** Return the part of the map around a car. */
export function around(town, pose) {
  return { middle: town.turned(pose.x, pose.y), size: [FOLLOWED, FOLLOWED * 0.75] };
}

/** One drive on the town's map. */
export class DriveMap {
  /** `noReturn` is the decision to mark as the point of no return; NaN for none. */
  constructor(canvas, town, drive, side, noReturn) {
    Object.assign(this, { canvas, town, drive, side, noReturn });
    this.context = canvas.getContext("2d");
  }

  /** Draw the map at a position of the replay. */
  draw(position, view, colour) {
    const { canvas, context, town } = this;
    const density = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (canvas.width !== Math.round(width * density) || canvas.height !== Math.round(height * density)) {
      canvas.width = Math.round(width * density);
      canvas.height = Math.round(height * density);
    }
    const scale = Math.min(width / view.size[0], height / view.size[1]); // pixels a metre
    this.pixel = 1 / scale;
    context.setTransform(density, 0, 0, density, 0, 0);
    context.fillStyle = colour("--ground");
    context.fillRect(0, 0, width, height);
    context.save();
    context.translate(width / 2, height / 2);
    context.scale(scale, -scale);
    context.translate(-view.middle[0], -view.middle[1]);
    context.rotate(Math.PI / 2 - town.up);
    this.drawTown(colour);
    this.drawBoards(colour);
    this.drawTrail(position, colour);
    this.drawOthers(position, colour);
    this.drawVerdict(colour);
    this.drawCar(poseAt(this.drive, position), colour);
    this.drawNoReturn(colour);
    context.restore();
    this.drawScale(scale, height, colour);
  }

  drawTown(colour) {
    const { context, town, pixel } = this;
    context.lineWidth = pixel;
    context.fillStyle = colour("--road");
    context.strokeStyle = colour("--road-edge");
    context.fill(town.road, "evenodd");
    context.globalAlpha = 0.25;
    context.fillStyle = colour("--road-edge");
    for (const junction of town.junctions) context.fill(junction, "evenodd");
    context.globalAlpha = 1;
    context.stroke(town.road);
    context.setLineDash([1.5, 1.5]);
    context.stroke(town.lanes);
    context.setLineDash([]);
    if (!town.stopLine) return;
    const { at: [x, y], heading } = town.stopLine;
    const [dx, dy] = [-Math.sin(heading) * WIDTH * 0.8, Math.cos(heading) * WIDTH * 0.8];
    context.lineWidth = Math.max(0.4, 2 * pixel);
    context.strokeStyle = colour("--text");
    context.beginPath();
    context.moveTo(x - dx, y - dy);
    context.lineTo(x + dx, y + dy);
    context.stroke();
  }

  /** Draw the boards that close a street. */
  drawBoards(colour) {
    const { context, drive: { boards }, pixel } = this;
    if (!boards) return;
    context.lineWidth = Math.max(0.5, 3 * pixel);
    context.strokeStyle = colour("--unsafe");
    context.beginPath();
    context.moveTo(boards[0], boards[1]);
    context.lineTo(boards[2], boards[3]);
    context.stroke();
  }

  drawTrail(position, colour) {
    const { context, drive, pixel } = this;
    const now = decisionAt(drive, position);
    const here = poseAt(drive, position);
    context.strokeStyle = colour(`--${this.side}`);
    context.lineWidth = 1.5 * pixel;
    context.setLineDash([4 * pixel, 4 * pixel]);
    this.line(now, drive.t.length - 1);
    context.setLineDash([]);
    context.lineWidth = 3 * pixel;
    this.line(0, now, here);
  }

  line(from, to, end) {
    const { context, drive } = this;
    context.beginPath();
    context.moveTo(drive.x[from], drive.y[from]);
    for (let i = from + 1; i <= to; i += 1) context.lineTo(drive.x[i], drive.y[i]);
    if (end) context.lineTo(end.x, end.y);
    context.stroke();
  }

  drawOthers(position, colour) {
    const { context, drive } = this;
    const others = drive.road_users?.[decisionAt(drive, position)] ?? [];
    context.fillStyle = colour("--neither");
    for (let i = 0; i < others.length; i += 5) {
      const [x, y, yaw, length, width] = others.slice(i, i + 5);
      if (length < PEDESTRIAN) {
        context.beginPath();
        context.arc(x, y, Math.max(0.5, 2 * this.pixel), 0, 2 * Math.PI);
        context.fill();
      } else {
        this.box({ x, y, yaw }, length, width);
        context.fill();
      }
    }
  }

  box({ x, y, yaw }, length, width) {
    const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
    this.context.beginPath();
    for (const [a, b] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
      const [along, left] = [(a * length) / 2, (b * width) / 2];
      this.context.lineTo(x + along * cos - left * sin, y + along * sin + left * cos);
    }
    this.context.closePath();
  }

  drawCar(pose, colour) {
    const { context, pixel } = this;
    // A car on a map of a whole town would be too small to be seen.
    const larger = Math.max(1, (14 * pixel) / LENGTH);
    const [cos, sin] = [Math.cos(pose.yaw), Math.sin(pose.yaw)];
    this.box(pose, LENGTH * larger, WIDTH * larger);
    context.fillStyle = colour(`--${this.side}`);
    context.fill();
    context.lineWidth = 1.5 * pixel;
    context.strokeStyle = colour("--text");
    context.stroke();
    const [front, half] = [LENGTH * larger * 0.2, WIDTH * larger * 0.4];
    context.beginPath();
    context.moveTo(pose.x + front * cos - half * sin, pose.y + front * sin + half * cos);
    context.lineTo(pose.x + front * cos + half * sin, pose.y + front * sin - half * cos);
    context.stroke();
  }

  /** Mark the place of the verdict: a cross is unsafe, a ring safe, a square neither. */
  drawVerdict(colour) {
    const { context, drive, pixel } = this;
    const [x, y, r] = [drive.x.at(-1), drive.y.at(-1), 9 * pixel];
    context.strokeStyle = colour(`--${this.side}`);
    context.lineWidth = 3 * pixel;
    context.beginPath();
    if (this.side === "safe") {
      context.arc(x, y, r, 0, 2 * Math.PI);
    } else if (this.side === "unsafe") {
      context.moveTo(x - r, y - r);
      context.lineTo(x + r, y + r);
      context.moveTo(x - r, y + r);
      context.lineTo(x + r, y - r);
    } else {
      context.rect(x - r, y - r, 2 * r, 2 * r);
    }
    context.stroke();
  }

  drawNoReturn(colour) {
    const { context, drive, noReturn, pixel } = this;
    if (!(noReturn < drive.t.length)) return;
    const [x, y, r] = [drive.x[noReturn], drive.y[noReturn], 8 * pixel];
    context.fillStyle = colour("--text");
    context.beginPath();
    for (const corner of [0, 1, 2]) {
      const angle = this.town.up + (corner * 2 * Math.PI) / 3;
      context.lineTo(x + r * Math.cos(angle), y + r * Math.sin(angle));
    }
    context.fill();
  }

  drawScale(scale, height, colour) {
    const { context } = this;
    const metres = [10, 20, 50, 100, 200].find((length) => length * scale >= 40) ?? 500;
    context.strokeStyle = colour("--text");
    context.fillStyle = colour("--text");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(10, height - 16);
    context.lineTo(10, height - 10);
    context.lineTo(10 + metres * scale, height - 10);
    context.lineTo(10 + metres * scale, height - 16);
    context.stroke();
    context.font = "12px system-ui, sans-serif";
    context.fillText(`${metres} m`, 14, height - 16);
  }
}
