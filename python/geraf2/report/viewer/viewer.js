// One 3D view of a page: scene, painter, controls and the elements around the canvas.

const element = (name, attributes = {}, ...children) => {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (value !== false && value !== null) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
};

class Viewer {
  constructor(root) {
    this.root = root;
    this.part = (name) => root.querySelector(`[data-part="${name}"]`);
    this.scene = readScene(JSON.parse(root.querySelector('script[type="application/json"]').textContent));
    this.canvas = this.part("canvas");
    this.painter = new Painter(this.canvas, this.scene);
    root.classList.add("works"); // the canvas has a size from now on
    this.camera = new Camera();
    this.attribute = null;
    this.picks = [];
    this.measuring = false;
    this.slice = null;
    this.wiper = null;
    this.holders = [];
    this.linked = []; // viewers whose cameras follow this one's
    this.clip = { low: [-1e9, -1e9, -1e9], high: [1e9, 1e9, 1e9] };
    this.share = 0; // by which the parts are moved apart
    this.named = null; // plane that is shown by its number
    const keys = {
      f: () => this.fit(),
      a: () => this.fit(true),
      o: () => this.toggle("orthographic"),
      m: () => this.toggle("measure"),
      s: () => savePicture(this),
      Enter: () => this.pickAt(this.canvas.clientWidth / 2, this.canvas.clientHeight / 2),
      Escape: () => this.clearPicks(),
    };
    this.controls = new Controls(this.canvas, this.camera, {
      changed: () => this.redraw(),
      picked: (x, y) => this.pickAt(x, y),
      keys,
    });
    this.measureScene();
    this.buildLayers();
    this.buildColours();
    this.buildCuts();
    this.buildSlices();
    this.buildApart();
    this.buildWiper();
    this.buildButtons();
    this.controls.viewFrom("corner");
    this.fit();
    this.showPicks();
    new ResizeObserver(() => this.redraw()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
    this.canvas.addEventListener("webglcontextlost", () => showPictures(root));
  }

  // Layers of the scene, surfaces first.
  get layers() {
    return [...this.scene.meshes, this.scene.faces, this.scene.glints, this.scene.planes].filter(Boolean);
  }

  measureScene() {
    const points = (layer) => layer.positions || layer.corners;
    this.whole = boundsOf(this.layers.map(points));
    const { meshes } = this.scene;
    const [content] = meshes;
    const kinds = [meshes.filter((mesh) => !mesh.walls && content.indices.length), meshes.filter((mesh) => mesh.walls), this.layers];
    this.inner = kinds.map((layers) => boundsOf(layers.map(points))).find(({ low }) => low.every(Number.isFinite));
  }

  buildLayers() {
    const rows = this.layers.map((layer) => {
      const box = element("input", { type: "checkbox", onchange: () => {
        layer.visible = box.checked;
        this.redraw();
      } });
      box.checked = layer.visible;
      const name = element("label", {}, box, element("i", { style: `background:${layer.colour}` }), layer.label);
      const range = element("input", {
        type: "range", min: 0, max: 100, value: 100 * layer.opacity, "aria-label": `opacity of: ${layer.label}`,
        oninput: () => {
          layer.opacity = range.value / 100;
          this.redraw();
        },
      });
      return element("div", { class: "layer" }, name, layer === this.scene.glints ? "" : range);
    });
    this.part("layers").append(...rows);
    const { planes } = this.scene;
    const corners = planes ? [...planes.corners] : [];
    const options = Array.from({ length: corners.length / 12 }, (_, n) => {
      const own = corners.slice(12 * n, 12 * n + 12);
      const [x, y, z] = [0, 1, 2].map((k) => (own[k] + own[k + 6]) / 2);
      const [azimuth, up] = [Math.atan2(y, x), Math.atan2(z, Math.hypot(x, y))].map((a) => Math.round((a * 180) / Math.PI));
      return element("option", { value: n }, `plane ${n + 1}: at ${azimuth}°, ${up}° up`);
    });
    const select = element("select", { "aria-label": "plane", onchange: () => {
      this.named = select.value === "" ? null : Number(select.value);
      this.redraw();
    } }, element("option", { value: "" }, "show one plane"), ...options);
    if (options.length) this.part("layers").append(select);
    this.part("reduced").textContent = this.layers.map((layer) => layer.note).filter(Boolean).join(" ");
  }

  buildColours() {
    const select = this.part("colours");
    this.content = this.scene.meshes.find((mesh) => mesh.attributes.length) || this.scene.meshes[0];
    const found = this.content ? this.content.attributes : [];
    select.append(...found.map((attribute, i) => element("option", { value: i }, attribute.label)));
    select.append(element("option", { value: -1 }, "one colour"));
    select.addEventListener("change", () => this.colourBy(found[select.value] || null));
    this.colourBy(found[0] || null);
  }

  colourBy(attribute) {
    this.attribute = attribute;
    if (this.content) this.painter.paint(this.content, attribute);
    this.part("about").textContent = attribute ? attribute.note || "" : "";
    this.showLegend();
    this.redraw();
  }

  // Colours of the content and of the slice.
  showLegend() {
    const shown = [this.attribute, this.slice && this.slice.volume].filter(Boolean);
    const legend = this.part("legend");
    legend.replaceChildren(...shown.flatMap(({ label, unit, classes, colours, range }) => {
      const title = element("b", {}, label + (unit ? ` [${unit}]` : ""));
      if (classes) {
        return [title, ...classes.slice(0, colours.length).map((name, i) =>
          element("span", { class: "swatch" }, element("i", { style: `background:${colours[i]}` }), name))];
      }
      const [low, high] = range;
      const ticks = [0, 0.25, 0.5, 0.75, 1].map((t) => low + t * (high - low));
      const digits = ticks.every((t) => Math.abs(t - Math.round(t)) < 1e-6) ? 0 : high - low < 2 ? 2 : 1;
      return [
        title,
        element("div", { class: "scale", style: `background:linear-gradient(90deg,${colours.join()})` }),
        element("div", { class: "ticks" }, ...ticks.map((t) => element("span", {}, millimetres(t, digits)))),
      ];
    }));
    legend.hidden = !shown.length;
  }

  buildCuts() {
    ["x", "y", "z"].forEach((name, axis) => {
      const [low, high] = [this.inner.low[axis], this.inner.high[axis]];
      const output = element("output", {}, "whole");
      const side = element("button", { type: "button", "aria-pressed": "false", title: "cut away the other side",
        "aria-label": `cut away the other side along ${name}`, onclick: () => {
          side.setAttribute("aria-pressed", String(side.getAttribute("aria-pressed") !== "true"));
          range.value = 1000 - range.value;
          update();
        } }, "⇄");
      const range = element("input", { type: "range", min: 0, max: 1000, value: 1000, "aria-label": `cut along ${name}`,
        oninput: () => update() });
      const update = () => {
        const flipped = side.getAttribute("aria-pressed") === "true";
        const at = low + (high - low) * (range.value / 1000);
        const whole = flipped ? range.value <= 0 : range.value >= 1000;
        this.clip.low[axis] = flipped && !whole ? at : -1e9;
        this.clip.high[axis] = !flipped && !whole ? at : 1e9;
        output.textContent = whole ? "whole" : `${flipped ? "≥" : "≤"} ${millimetres(at)} mm`;
        this.redraw();
      };
      this.part("cuts").append(element("div", { class: "cut" }, element("span", {}, name), range, output, side));
    });
  }

  // One slice across an axis, through one of the volumes.
  buildSlices() {
    const part = this.part("slices");
    part.hidden = !this.scene.volumes.length;
    if (part.hidden) return;
    const options = this.scene.volumes.flatMap((volume, n) =>
      ["x", "y", "z"].map((axis, k) => element("option", { value: `${n} ${k}` }, `${volume.label}, across ${axis}`)));
    const select = element("select", { "aria-label": "slice", onchange: () => update() }, element("option", { value: "" }, "off"), ...options);
    const range = element("input", { type: "range", min: 0, max: 1000, value: 500, "aria-label": "position of the slice", oninput: () => update() });
    const output = element("output", {}, "");
    const update = () => {
      this.slice = null;
      output.textContent = "";
      if (select.value) {
        const [n, axis] = select.value.split(" ").map(Number);
        const volume = this.scene.volumes[n];
        const at = volume.origin[axis] + (range.value / 1000) * (volume.shape[axis] - 1) * volume.spacing;
        this.slice = { volume, axis, at };
        output.textContent = `${millimetres(at)} mm`;
      }
      range.disabled = !this.slice;
      this.showLegend();
      this.redraw();
    };
    part.append(select, element("div", { class: "cut slice" }, range, output));
    update();
  }

  // Exploded view: groups of vertices move along their offsets.
  buildApart() {
    const part = this.part("apart");
    const offsets = this.scene.apart;
    part.hidden = !offsets;
    if (!offsets) return;
    const range = element("input", { type: "range", min: 0, max: 100, value: 0, "aria-label": "move the parts apart", oninput: () => update() });
    const output = element("output", {}, "together");
    const update = () => {
      this.share = range.value / 100;
      output.textContent = this.share ? `${range.value} %` : "together";
      for (const mesh of this.scene.meshes.filter(({ groups }) => groups)) {
        mesh.positions.forEach((_, i) => {
          mesh.positions[i] = mesh.home[i] + this.share * offsets[mesh.groups[Math.floor(i / 3)]][i % 3];
        });
        this.painter.place(mesh);
      }
      this.measureScene();
      this.clearPicks();
      this.fit();
    };
    part.append(element("div", { class: "cut slice" }, range, output));
  }

  // Content on the left of a line, what it is compared with on the right.
  buildWiper() {
    const [field, line] = [this.part("wiper"), this.part("wiper-line")];
    const others = this.scene.meshes.filter((mesh) => mesh.reference && mesh.indices.length);
    field.hidden = line.hidden = true;
    this.part("compare").hidden = !others.length;
    if (!others.length) return;
    const range = element("input", { type: "range", min: 0, max: 1000, value: 500,
      "aria-label": `wiper: content on the left, ${others[0].label} on the right`, oninput: () => update() });
    const update = () => {
      const on = this.part("compare").getAttribute("aria-pressed") === "true";
      field.hidden = line.hidden = !on;
      this.wiper = on ? range.value / 1000 : null;
      line.style.left = `${range.value / 10}%`;
      this.redraw();
    };
    field.append(element("span", {}, this.content.label), range, element("span", {}, others[0].label));
    this.part("compare").textContent = `compare with ${others[0].label}`;
    this.part("compare").addEventListener("click", (event) => {
      const button = event.currentTarget;
      button.setAttribute("aria-pressed", String(button.getAttribute("aria-pressed") !== "true"));
      update();
    });
  }

  buildButtons() {
    for (const button of this.root.querySelectorAll("[data-view]")) {
      button.addEventListener("click", () => this.controls.viewFrom(button.dataset.view));
    }
    const click = (name, what) => this.part(name).addEventListener("click", what);
    click("fit", () => this.fit());
    click("all", () => this.fit(true));
    click("save", () => savePicture(this));
    click("film", () => saveTurn(this));
    if (!filmKind()) this.part("film").hidden = true;
    click("orthographic", () => this.toggle("orthographic"));
    click("measure", () => this.toggle("measure"));
    const full = this.part("fullscreen");
    if (!document.fullscreenEnabled) full.hidden = true;
    full.addEventListener("click", () => {
      if (document.fullscreenElement) document.exitFullscreen();
      else this.root.requestFullscreen();
    });
  }

  toggle(name) {
    const button = this.part(name);
    const on = button.getAttribute("aria-pressed") !== "true";
    button.setAttribute("aria-pressed", String(on));
    if (name === "orthographic") this.camera.orthographic = on;
    else {
      this.measuring = on;
      this.clearPicks();
    }
    this.redraw();
  }

  // Fit the content, or everything shown, into the view.
  fit(all = false) {
    const shown = this.layers.filter((layer) => layer.visible);
    const everything = boundsOf((shown.length ? shown : this.layers).map((l) => l.positions || l.corners));
    const { low, high } = all ? everything : this.inner;
    this.camera.target = low.map((value, axis) => (value + high[axis]) / 2);
    const radius = norm(plus(high, low, -1)) / 2;
    this.camera.distance = ((all ? 1.02 : 1.3) * radius) / (HALF_VIEW * Math.min(1, this.aspect()));
    this.redraw();
  }

  aspect() {
    return this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight);
  }

  reach() {
    const middle = this.whole.low.map((value, axis) => (value + this.whole.high[axis]) / 2);
    const radius = norm(plus(this.whole.high, this.whole.low, -1)) / 2;
    return radius + norm(plus(middle, this.camera.target, -1)) + 1;
  }

  // Take over the camera of another view.
  follow({ azimuth, elevation, distance, orthographic, target }) {
    Object.assign(this.camera, { azimuth, elevation, distance, orthographic, target: [...target] });
    this.part("orthographic").setAttribute("aria-pressed", String(orthographic));
    this.redraw(false);
  }

  redraw(leads = true) {
    if (leads) for (const other of this.linked) other.follow(this.camera);
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      this.draw();
    });
  }

  draw() {
    const pixel = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!width || !height) return;
    if (!Number.isFinite(this.camera.distance)) this.fit(); // the frame had no size before
    const sharp = [Math.round(width * pixel), Math.round(height * pixel)];
    if (this.canvas.width !== sharp[0] || this.canvas.height !== sharp[1]) {
      [this.canvas.width, this.canvas.height] = sharp;
    }
    const axes = this.camera.axes();
    const columns = [0, 1, 2].flatMap((c) => axes.map((axis) => axis[c]));
    const cut = rgb(getComputedStyle(this.root).getPropertyValue("--cut").trim());
    const matrix = this.camera.matrix(this.aspect(), this.reach());
    const held = [...new Set([...this.holders.map(({ pose }) => pose), this.named])].filter((n) => n !== null);
    const { clip, slice, wiper } = this;
    this.painter.draw({ matrix, columns, clip, cut, pixel, held, slice, wiper });
    this.drawOverlay(axes);
  }

  onCanvas(point) {
    const at = this.camera.project(point, this.aspect());
    if (!at) return null;
    return [((at[0] + 1) / 2) * this.canvas.clientWidth, ((1 - at[1]) / 2) * this.canvas.clientHeight];
  }

  drawOverlay(axes) {
    ["x", "y", "z"].forEach((name, k) => {
      const tip = [axes[0][k] * 26, -axes[1][k] * 26];
      const line = this.part(`axis-${name}`);
      line.querySelector("line").setAttribute("x2", tip[0]);
      line.querySelector("line").setAttribute("y2", tip[1]);
      line.querySelector("text").setAttribute("x", tip[0] * 1.38);
      line.querySelector("text").setAttribute("y", tip[1] * 1.38);
    });
    const scale = this.canvas.clientHeight / (2 * this.camera.halfHeight());
    const length = [500, 200, 100, 50, 20, 10, 5, 2, 1, 0.5].find((n) => n * scale <= 130) || 0.2;
    this.part("bar").style.width = `${length * scale}px`;
    this.part("length").textContent = `${length} mm`;
    const marked = this.picks.map(({ point }) => this.onCanvas(point));
    const marks = this.part("marks");
    marks.querySelectorAll(":scope > circle").forEach((circle, i) => {
      const at = marked[i];
      circle.style.display = at ? "" : "none";
      if (at) {
        circle.setAttribute("cx", at[0]);
        circle.setAttribute("cy", at[1]);
      }
    });
    const spots = this.holders.slice(0, 60).map(({ at }) => this.onCanvas(at)).filter(Boolean);
    this.part("peaks").replaceChildren(...spots.map(([cx, cy]) => {
      const spot = marks.querySelector(":scope > circle").cloneNode();
      spot.removeAttribute("style");
      Object.entries({ cx, cy, r: 2.5 }).forEach(([key, value]) => spot.setAttribute(key, value));
      return spot;
    }));
    const line = marks.querySelector("line");
    const text = marks.querySelector("text");
    const both = marked.length === 2 && marked[0] && marked[1];
    line.style.display = text.style.display = both ? "" : "none";
    if (!both) return;
    const [[x1, y1], [x2, y2]] = marked;
    Object.entries({ x1, y1, x2, y2 }).forEach(([key, value]) => line.setAttribute(key, value));
    text.setAttribute("x", (x1 + x2) / 2);
    text.setAttribute("y", (y1 + y2) / 2 - 8);
    text.textContent = `${millimetres(norm(plus(this.picks[1].home, this.picks[0].home, -1)))} mm`;
  }

  // Hit under a point of the canvas [pixels], or null.
  find(x, y) {
    const across = (2 * x) / this.canvas.clientWidth - 1;
    const up = 1 - (2 * y) / this.canvas.clientHeight;
    const ray = this.camera.ray(across, up, this.aspect(), this.reach());
    const inside = (p) => p.every((value, k) => value >= this.clip.low[k] && value <= this.clip.high[k]);
    let best = null;
    const wiped = this.wiper !== null;
    const right = wiped && x > this.wiper * this.canvas.clientWidth;
    for (const mesh of this.scene.meshes) {
      if (mesh.walls || (wiped && Boolean(mesh.reference) !== right)) continue;
      if (!(right || (mesh.visible && mesh.opacity))) continue;
      const hit = firstHit(mesh, ray, inside);
      if (hit && (!best || hit.t < best.t)) best = { ...hit, mesh };
    }
    if (!best) return null;
    const corners = [0, 1, 2].map((k) => best.mesh.indices[3 * best.face + k]);
    const mean = (attribute) => {
      const values = corners.map((corner) => attribute.values[corner]);
      if (attribute.classes) return values[best.weights.indexOf(Math.max(...best.weights))];
      return dot(values, best.weights);
    };
    best.normal = unit([0, 1, 2].map((d) =>
      corners.reduce((sum, corner, k) => sum + best.weights[k] * best.mesh.normals[3 * corner + d], 0)));
    const { groups } = best.mesh;
    const shift = groups && this.share ? this.scene.apart[groups[corners[0]]] : [0, 0, 0];
    best.home = plus(best.point, shift, -this.share);
    best.values = best.mesh.attributes.map((attribute) => [attribute, mean(attribute)]);
    return best;
  }

  pickAt(x, y) {
    const found = this.find(x, y);
    if (!found) {
      if (!this.measuring) this.clearPicks();
      return;
    }
    this.picks = this.measuring && this.picks.length === 1 ? [this.picks[0], found] : [found];
    this.showPicks();
  }

  clearPicks() {
    this.picks = [];
    this.showPicks();
  }

  showPicks() {
    const row = (name, text) => element("div", {}, element("dt", {}, name), element("dd", {}, text));
    const list = element("dl");
    const last = this.picks[this.picks.length - 1];
    const box = this.part("readout");
    const { glints } = this.scene;
    const single = last && this.picks.length === 1 && last.mesh === this.content && glints;
    this.holders = single ? holdersOf(glints, last.point, last.normal) : [];
    if (!last) {
      const hint = this.measuring ? "Click two points of the surface." : "Click the surface, or press Enter for its middle.";
      box.replaceChildren(element("p", {}, hint));
    } else if (this.picks.length === 2) {
      const apart = plus(last.home, this.picks[0].home, -1);
      list.append(row("distance", `${millimetres(norm(apart), 2)} mm`));
      ["x", "y", "z"].forEach((name, k) => list.append(row(`along ${name}`, `${millimetres(apart[k], 2)} mm`)));
      box.replaceChildren(list);
    } else {
      list.append(row("on", last.mesh.label));
      ["x", "y", "z"].forEach((name, k) => list.append(row(name, `${millimetres(last.home[k], 2)} mm`)));
      for (const [attribute, value] of last.values) list.append(row(attribute.label, formatted(attribute, value)));
      if (single) {
        const planes = [...new Set(this.holders.map(({ pose }) => pose + 1))].sort((a, b) => a - b);
        const n = this.holders.length;
        list.append(row("held by", n ? `${n} peak${n > 1 ? "s" : ""}` : `no peak within ${glints.reach} mm`));
        if (n) list.append(row(planes.length > 1 ? "of planes" : "of plane", planes.join(", ")));
        if (n) list.append(row("strongest", `${Math.max(...this.holders.map((h) => h.decibels)).toFixed(0)} dB`));
      }
      box.replaceChildren(list, ...(this.measuring ? [element("p", {}, "Click the second point.")] : []));
    }
    this.redraw();
  }
}

// Without a view, the pictures of the surface and their note stand in its place in a report.
function showPictures(root) {
  root.classList.remove("works");
  const section = document.getElementById("surface");
  if (!section || !root.closest(".hero")) return;
  root.querySelector(".fallback").after(...section.querySelectorAll(".note, figure"));
  section.hidden = true;
  document.querySelector('.side a[href="#surface"]').parentElement.remove();
}

const viewers = [];
for (const root of document.querySelectorAll(".viewer")) {
  try {
    root.viewer = new Viewer(root);
    viewers.push(root.viewer);
  } catch (error) {
    console.warn(`no 3D view: ${error.message}`);
    // This script runs before the sections with the pictures are parsed.
    addEventListener("DOMContentLoaded", () => showPictures(root));
  }
}

// The button that links the cameras of two views.
const link = document.querySelector('[data-part="link"]');
const setLinks = (on) => {
  link.setAttribute("aria-pressed", String(on));
  for (const viewer of viewers) viewer.linked = on ? viewers.filter((other) => other !== viewer) : [];
  viewers[0].redraw();
};
if (link && viewers.length > 1) {
  link.addEventListener("click", () => setLinks(link.getAttribute("aria-pressed") !== "true"));
  setLinks(true);
}
