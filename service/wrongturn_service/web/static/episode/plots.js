// Speed and commands over time.
import { STEP, commandName } from "./timeline.js";

const LEVELS = [4, 2, 3, 1]; // from the lowest line of the plot to the highest
const HEIGHT = 160;
const AXIS = 110; // pixels, the same in all plots, so that times lie below each other

/** A plot over time, with a line at the time that the replay shows. */
class Plot {
  constructor(parent, data, series, axis, range, seek, colour) {
    const line = { stroke: () => colour("--text"), grid: { stroke: () => colour("--line") }, ticks: { stroke: () => colour("--line") } };
    this.parent = parent;
    this.chart = new window.uPlot(
      {
        width: Math.max(parent.clientWidth, 200),
        height: HEIGHT,
        legend: { show: false },
        cursor: { drag: { x: false, y: false }, points: { show: false }, y: false },
        scales: { x: { time: false }, y: { range } },
        axes: [{ ...line, size: 30, values: (_, ticks) => ticks.map((tick) => `${tick} s`) }, { ...line, ...axis }],
        series: [{}, ...series],
      },
      data,
      parent,
    );
    this.now = document.createElement("div");
    this.now.className = "now";
    this.chart.over.append(this.now);
    this.chart.over.addEventListener("click", (event) => {
      seek(this.chart.posToVal(event.clientX - this.chart.over.getBoundingClientRect().left, "x") / STEP);
    });
  }

  /** Put the line at a position of the replay. */
  show(position) {
    this.now.style.transform = `translateX(${this.chart.valToPos(position * STEP, "x")}px)`;
  }

  /** Mark a decision as the point of no return, if it is a number. */
  mark(decision) {
    this.marked = document.createElement("div");
    this.marked.className = "no-return";
    this.marked.hidden = Number.isNaN(decision);
    this.decision = decision;
    this.chart.over.append(this.marked);
    this.place();
  }

  place() {
    if (!this.marked.hidden) this.marked.style.transform = `translateX(${this.chart.valToPos(this.decision * STEP, "x")}px)`;
  }

  /** Draw again, in the width and the colours that the page has now. */
  redraw() {
    this.chart.setSize({ width: Math.max(this.parent.clientWidth, 200), height: HEIGHT });
    this.place();
  }
}

const times = (drives) => {
  const count = Math.max(...drives.map((drive) => drive.t.length));
  return Array.from({ length: count }, (_, i) => i * STEP);
};
const filled = (values, count) => Array.from({ length: count }, (_, i) => values[i] ?? null);

/** Return the plot of the speeds of up to three drives; the second one is dashed, the third one dotted. */
export function speedPlot(parent, drives, sides, seek, colour) {
  const t = times(drives);
  const series = drives.map((_, i) => ({ stroke: () => colour(`--${sides[i]}`), width: 2, dash: [[], [6, 5], [2, 4]][i], points: { show: false } }));
  const data = [t, ...drives.map((drive) => filled(drive.v.map((v) => 3.6 * v), t.length))];
  const top = Math.max(20, ...drives.map((drive) => 3.6 * Math.max(...drive.v)));
  return new Plot(parent, data, series, { size: AXIS }, [0, 1.1 * top], seek, colour);
}

/** Return the plot of the command and the route's command, which is dashed. */
export function commandPlot(parent, drives, seek, colour) {
  const t = times(drives);
  const [drive] = drives;
  const levels = drive.command.concat(drive.route_command).includes(-1) ? [-1, ...LEVELS] : LEVELS;
  const level = (command) => levels.indexOf(command);
  const stepped = window.uPlot.paths.stepped({ align: 1 });
  const series = [
    { stroke: () => colour("--text"), width: 3, paths: stepped, points: { show: false } },
    { stroke: () => colour("--link"), width: 2, dash: [6, 5], paths: stepped, points: { show: false } },
  ];
  const data = [t, filled(drive.command.map(level), t.length), filled(drive.route_command.map(level), t.length)];
  const axis = { size: AXIS, splits: () => levels.map((_, i) => i), values: () => levels.map(commandName) };
  return new Plot(parent, data, series, axis, [-0.5, levels.length - 0.5], seek, colour);
}
