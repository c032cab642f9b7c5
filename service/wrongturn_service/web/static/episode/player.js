// Time: what plays, pauses and seeks, by mouse and by keyboard.
import { STEP, within } from "./timeline.js";

const KEYS = new Map([["ArrowLeft", -1], ["ArrowRight", 1], ["PageUp", 10], ["PageDown", -10]]);
const ANYWHERE = new Set([" ", "ArrowLeft", "ArrowRight"]);

/** The clock of a replay. Nothing plays before somebody asks for it. */
export class Player {
  /**
   * @param {HTMLElement} section holds the controls; with the focus in it, all keys are its own
   * @param {number} count number of decisions
   * @param {(position: number, playing: boolean) => void} show called whenever the position changes
   */
  constructor(section, count, show) {
    Object.assign(this, { count, show, position: 0, playing: false });
    const find = (name) => section.querySelector(`.${name}`);
    [this.play, this.scrub, this.pace] = [find("play"), find("scrub"), find("pace")];
    this.scrub.max = count - 1;
    this.play.addEventListener("click", () => this.toggle());
    this.scrub.addEventListener("input", () => this.seek(Number(this.scrub.value)));
    section.addEventListener("keydown", (event) => this.pressed(event));
    document.addEventListener("keydown", (event) => {
      // Without a focus these keys mean the player too. The others scroll the page.
      if (event.target.matches("body, main") && ANYWHERE.has(event.key)) this.pressed(event);
    });
  }

  /** Go to a position and stay there. */
  seek(position) {
    this.pause();
    this.move(Math.round(position));
  }

  toggle() {
    if (this.playing) {
      this.pause();
      this.move(Math.round(this.position));
      return;
    }
    if (this.position >= this.count - 1) this.move(0);
    this.playing = true;
    this.play.textContent = "Pause";
    this.before = performance.now();
    requestAnimationFrame((now) => this.tick(now));
  }

  pause() {
    this.playing = false;
    this.play.textContent = "Play";
  }

  tick(now) {
    if (!this.playing) return;
    const elapsed = Math.max(0, now - this.before) / 1000;
    this.before = now;
    const next = this.position + (elapsed * Number(this.pace.value)) / STEP;
    if (next >= this.count - 1) this.pause();
    this.move(next);
    if (this.playing) requestAnimationFrame((later) => this.tick(later));
  }

  move(position) {
    this.position = within(position, this.count);
    this.scrub.value = Math.round(this.position);
    this.scrub.setAttribute("aria-valuetext", `${(this.position * STEP).toFixed(1)} s`);
    this.show(this.position, this.playing);
  }

  pressed(event) {
    const { key, target } = event;
    if (event.ctrlKey || event.altKey || event.metaKey || target.matches("select")) return;
    // A button and a checkbox have a use for the space bar.
    if (key === " " && !target.matches("button, [type=checkbox]")) this.toggle();
    else if (KEYS.has(key)) this.seek(this.position + KEYS.get(key));
    else if (key === "Home") this.seek(0);
    else if (key === "End") this.seek(this.count - 1);
    else return;
    event.preventDefault();
  }
}
