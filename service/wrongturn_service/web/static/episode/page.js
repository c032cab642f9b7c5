// The replay of an episode, and of its twin and a fork at the same time.
import { CameraView } from "./camera.js";
import { DriveMap, Town, around, freeCorner, whole } from "./map.js";
import { Player } from "./player.js";
import { commandPlot, speedPlot } from "./plots.js";
import { STEP, decisionAt, passed, poseAt, said, seconds, timeIn } from "./timeline.js";

const section = document.querySelector(".player");
const figures = [...section.querySelectorAll(".drive")];

async function fetched(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  return response.json();
}

/** Return a function that gives the value of a colour of the style sheet. */
function colours() {
  const style = getComputedStyle(document.documentElement);
  const known = new Map();
  return (name) => {
    if (!known.has(name)) known.set(name, style.getPropertyValue(name).trim());
    return known.get(name);
  };
}

/** Turn the times of the tables of moments into buttons, and return the moments of the first table. */
function linkMoments(seek) {
  const tables = [...document.querySelectorAll(".moments")];
  const found = tables.map((table) =>
    [...table.querySelectorAll("[data-decision]")].map((cell) => {
      const decision = Number(cell.dataset.decision);
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = cell.textContent;
      button.addEventListener("click", () => seek(decision));
      cell.replaceChildren(button);
      return { decision, text: cell.nextElementSibling.textContent };
    }),
  );
  return found[0] ?? [];
}

function start(detail, drives) {
  const { journey, approach, noReturn: marked } = section.dataset;
  const noReturn = Number(marked ?? NaN);
  const town = new Town(detail, journey === undefined ? approach : null);
  const everything = whole(town, drives);
  const count = Math.max(...drives.map((drive) => drive.t.length));
  const sides = figures.map((figure) => figure.dataset.side);
  let colour = colours();
  const current = (name) => colour(name);
  section.hidden = false;

  const maps = drives.map((drive, i) => new DriveMap(figures[i].querySelector(".map"), town, drive, sides[i], figures[i].dataset.twin === undefined ? noReturn : NaN));
  const cameras = drives.map((drive, i) => {
    const [canvas, unseen] = [".camera", ".unseen"].map((name) => figures[i].querySelector(name));
    return new CameraView(canvas, figures[i].dataset.episode, drive.t.length, unseen);
  });
  const readouts = figures.map((figure) => [...figure.querySelectorAll("[data-value]")]);
  const commands = figures.map((figure) => figure.querySelector(".command"));
  const [clock, status, follow, copy] = ["clock", "status", "follow", "copy"].map((name) => section.querySelector(`.${name}`));
  let moments = [];
  let before = 0;
  let later = 0;

  const describe = (position) => {
    const drive = drives[0];
    const words = said(drive, decisionAt(drive, position));
    return `${seconds(position * STEP)}: ${words.speed}, command: ${words.command}, route: ${words.route}.`;
  };
  const address = (position) => {
    if (position || timeIn(location.hash) !== null) history.replaceState(null, "", `#t=${(position * STEP).toFixed(1)}`);
  };
  const rest = (position) => {
    status.textContent = describe(position);
    address(position);
  };
  const draw = (position) => {
    drives.forEach((drive, i) => {
      const view = follow.checked ? around(town, poseAt(drive, position)) : everything;
      maps[i].draw(position, view, current);
    });
  };
  const show = (position, playing) => {
    draw(position);
    drives.forEach((drive, i) => {
      const decision = decisionAt(drive, position);
      cameras[i].show(decision);
      const words = said(drive, decision);
      for (const element of readouts[i]) {
        const text = words[element.dataset.value];
        if (element.textContent !== text) element.textContent = text;
      }
      commands[i].classList.toggle("differs", words.command !== words.route);
    });
    plots.forEach((plot) => plot.show(position));
    clock.textContent = `${seconds(position * STEP)} of ${seconds((count - 1) * STEP)}`;
    // The line of status speaks: at rest, or of a moment that the replay passes.
    const news = playing ? passed(moments, before, position) : [];
    before = position;
    if (news.length) status.textContent = `${seconds(position * STEP)}: ${news.map(({ text }) => text).join(" ")}`;
    clearTimeout(later);
    if (!playing) later = setTimeout(() => rest(position), 150);
  };

  const player = new Player(section, count, show);
  const seek = (position) => player.seek(position);
  moments = linkMoments(seek);
  const plots = [
    speedPlot(section.querySelector(".speeds"), drives, sides, seek, current),
    commandPlot(section.querySelector(".commands"), drives, seek, current),
  ];
  plots.forEach((plot) => plot.mark(noReturn));
  const insets = figures.map((figure) => figure.querySelector(".seen"));
  const place = () => {
    const corner = freeCorner(town, drives, everything, maps[0].canvas, insets[0]);
    for (const inset of insets) inset.dataset.corner = corner;
  };
  const again = () => {
    place();
    colour = colours();
    plots.forEach((plot) => plot.redraw());
    show(player.position, player.playing);
  };
  copy.addEventListener("click", async () => {
    history.replaceState(null, "", `#t=${(player.position * STEP).toFixed(1)}`);
    clearTimeout(later);
    try {
      await navigator.clipboard.writeText(location.href);
      status.textContent = `The address with the time ${seconds(player.position * STEP)} is copied.`;
    } catch { // without https, browsers let no page copy
      status.textContent = "Copy the address of this page from the browser’s address bar: it has the time.";
    }
  });
  const jump = (url) => {
    const time = timeIn(new URL(url).hash);
    if (time !== null) seek(time / STEP);
  };
  // At rest, the replay may have written its own time into the address before the event comes; the event has yours.
  window.addEventListener("hashchange", ({ newURL }) => jump(newURL));
  follow.addEventListener("change", () => draw(player.position));
  window.addEventListener("resize", again);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  place();
  player.move(0);
  jump(location.href);
  performance.mark("interactive");
  section.dataset.ready = "";
}

try {
  const [detail, ...drives] = await Promise.all([
    fetched(`../v1/towns/${encodeURIComponent(section.dataset.town)}`),
    ...figures.map(({ dataset }) => fetched(`../episodes/${dataset.episode}/drive.json`)),
  ]);
  start(detail, drives);
} catch (error) {
  const failure = document.querySelector("#failure");
  failure.textContent = `The replay cannot be shown (${error.message}). Load the page again. The moments below tell the same in words.`;
  failure.hidden = false;
}
