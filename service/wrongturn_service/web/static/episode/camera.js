// The camera's pictures, which the service sends as sheets of several decisions.
import { sheetOf } from "./timeline.js";

const WIDTH = 192;
const HEIGHT = 64;
const KEPT = 12; // sheets

/** What the car's camera saw. */
export class CameraView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {string} episode its id
   * @param {number} count number of decisions
   * @param {HTMLElement} unseen says so if a picture could not be loaded
   */
  constructor(canvas, episode, count, unseen) {
    Object.assign(this, { canvas, episode, last: sheetOf(count - 1).sheet, unseen });
    this.context = canvas.getContext("2d");
    this.sheets = new Map();
    this.decision = -1;
  }

  /** Show the picture of a decision, as soon as it is here. */
  show(decision) {
    if (decision === this.decision) return;
    this.decision = decision;
    this.draw();
    const { sheet } = sheetOf(decision);
    if (sheet < this.last) this.load(sheet + 1);
  }

  draw() {
    const { sheet, row } = sheetOf(this.decision);
    const image = this.load(sheet);
    const broken = image.complete && !image.naturalWidth;
    const text = broken ? "The camera’s picture could not be loaded. Load the page again." : "";
    if (this.unseen.textContent !== text) this.unseen.textContent = text;
    if (broken) {
      this.context.clearRect(0, 0, WIDTH, HEIGHT);
      delete this.canvas.dataset.decision;
    }
    if (!image.complete || !image.naturalWidth) return;
    this.context.drawImage(image, 0, row * HEIGHT, WIDTH, HEIGHT, 0, 0, WIDTH, HEIGHT);
    this.canvas.dataset.decision = this.decision;
  }

  load(sheet) {
    let image = this.sheets.get(sheet);
    this.sheets.delete(sheet); // and put it last
    if (!image) {
      image = new Image();
      image.onload = image.onerror = () => sheetOf(this.decision).sheet === sheet && this.draw();
      image.src = `../v1/episodes/${this.episode}/camera/${sheet}`;
    }
    this.sheets.set(sheet, image);
    if (this.sheets.size > KEPT) this.sheets.delete(this.sheets.keys().next().value);
    return image;
  }
}
