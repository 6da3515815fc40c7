// Control of the camera by mouse, touch and keyboard.

const TURN = 0.008; // radians per pixel
const VIEWS = {
  "+x": [0, 0],
  "-x": [Math.PI, 0],
  "+y": [Math.PI / 2, 0],
  "-y": [-Math.PI / 2, 0],
  "+z": [-Math.PI / 2, Math.PI / 2],
  "-z": [-Math.PI / 2, -Math.PI / 2],
  corner: [-0.9, 0.38],
};

class Controls {
  // changed(): the camera moved; picked(x, y): a click, in pixels of the canvas; keys: further keys.
  constructor(canvas, camera, { changed, picked, keys }) {
    Object.assign(this, { canvas, camera, changed, picked, keys });
    this.pointers = new Map();
    this.moved = 0;
    const listen = (name, what, options) => canvas.addEventListener(name, what.bind(this), options);
    listen("pointerdown", this.down);
    listen("pointermove", this.move);
    listen("pointerup", this.up);
    listen("pointercancel", this.up);
    listen("wheel", this.wheel, { passive: false });
    listen("keydown", this.key);
    listen("contextmenu", (event) => event.preventDefault());
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    if (this.pointers.size === 1) this.moved = 0;
    else this.moved = Infinity; // two fingers are no click
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.offsetX, event.offsetY];
    const old = [...this.pointers.values()];
    this.pointers.set(event.pointerId, now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    this.moved += Math.abs(dx) + Math.abs(dy);
    if (this.pointers.size === 2) this.pinch(old, [...this.pointers.values()]);
    else if (event.buttons & 6 || event.shiftKey) this.pan(dx, dy);
    else this.turn(dx, dy);
  }

  up(event) {
    const known = this.pointers.delete(event.pointerId);
    if (known && this.moved < 5 && event.type === "pointerup") this.picked(event.offsetX, event.offsetY);
  }

  pinch(old, now) {
    const apart = ([a, b]) => Math.hypot(a[0] - b[0], a[1] - b[1]) || 1;
    const middle = ([a, b]) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];
    this.camera.distance *= apart(old) / apart(now);
    const [from, to] = [middle(old), middle(now)];
    this.pan(to[0] - from[0], to[1] - from[1]);
  }

  turn(dx, dy) {
    this.camera.azimuth -= TURN * dx;
    this.camera.elevation = clamp(this.camera.elevation + TURN * dy, -Math.PI / 2, Math.PI / 2);
    this.changed();
  }

  pan(dx, dy) {
    const [right, up] = this.camera.axes();
    const scale = (2 * this.camera.halfHeight()) / this.canvas.clientHeight;
    this.camera.target = plus(plus(this.camera.target, right, -scale * dx), up, scale * dy);
    this.changed();
  }

  zoom(factor) {
    this.camera.distance *= factor;
    this.changed();
  }

  // The wheel zooms only after a click, so that scrolling the page does not stop at the picture.
  wheel(event) {
    if (document.activeElement !== this.canvas && !event.ctrlKey) return;
    event.preventDefault();
    const lines = event.deltaMode === 1 ? 30 : 1;
    this.zoom(Math.exp(clamp(event.deltaY * lines, -200, 200) * 0.0015));
  }

  viewFrom(name) {
    [this.camera.azimuth, this.camera.elevation] = VIEWS[name];
    this.changed();
  }

  key(event) {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const step = arrows[event.key];
    if (step && event.shiftKey) this.pan(-20 * step[0], -20 * step[1]);
    else if (step) this.turn(12 * step[0], 12 * step[1]);
    else if (event.key === "+" || event.key === "=") this.zoom(0.9);
    else if (event.key === "-") this.zoom(1 / 0.9);
    else if (/^[1-7]$/.test(event.key)) this.viewFrom(Object.keys(VIEWS)[event.key - 1]);
    else if (this.keys[event.key]) this.keys[event.key]();
    else return;
    event.preventDefault();
  }
}
