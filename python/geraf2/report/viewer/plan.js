// Sliders of the page of a plan: minutes, channels, and the time of the scan.

class PlanPage {
  constructor(viewer, { minutes, channels, first, cells }) {
    Object.assign(this, { viewer, minutes, channels, cells });
    this.part = (name) => document.querySelector(`[data-plan="${name}"]`);
    [["minutes", minutes, first[0]], ["channels", channels, first[1]]].forEach(([name, all, at]) => {
      const range = this.part(name);
      range.max = all.length - 1;
      range.value = at;
      range.addEventListener("input", () => this.choose());
    });
    this.part("time").addEventListener("input", () => this.move());
    viewer.root.querySelector('[aria-label="plane"]').hidden = true; // lists those of one plan
    viewer.fit(true);
    this.choose();
  }

  choose() {
    const [row, column] = ["minutes", "channels"].map((name) => Number(this.part(name).value));
    const plan = this.cells[row][column];
    this.plan = plan;
    this.part("minutes-text").textContent = `${this.minutes[row]} minutes`;
    if (this.channels[column]) this.part("channels-text").textContent = `${this.channels[column]} channels`;
    for (const name of ["planes", "spacing", "time-text", "seen", "expected"]) {
      const key = name.replace("-text", "");
      this.part(name).textContent = plan ? plan[key] : key === "planes" ? "No plan fits into this time." : "";
    }
    const { painter, scene, content } = this.viewer;
    painter.setPath(plan ? stretched(plan.path) : new Float32Array());
    scene.planes.corners = new Float32Array(plan ? plan.corners.flat(2) : []);
    painter.planes = painter.preparePlanes(scene.planes);
    const [seen] = content.attributes;
    seen.values = plan ? Float32Array.from(numbers(plan.counts)) : new Float32Array(seen.values.length);
    this.viewer.colourBy(seen);
    this.move();
  }

  // The path until now is drawn strongly, and the plane that is scanned now is shown.
  move() {
    if (!this.plan) return this.viewer.redraw();
    const { times, owners } = this.plan;
    const end = times[times.length - 1][1];
    const now = (this.part("time").value / 1000) * end;
    const begun = times.filter(([start]) => start <= now).length;
    this.viewer.painter.pathDone = 2 * begun;
    const whole = now >= end;
    this.viewer.named = whole ? null : owners[Math.max(0, begun - 1)];
    this.viewer.scene.planes.visible = whole;
    this.part("now").textContent = whole ? "whole scan" : `after ${Math.floor(now / 60)} min ${Math.floor(now % 60)} s, plane ${this.viewer.named + 1}`;
    return this.viewer.redraw();
  }
}

const planned = document.querySelector("#plan-data");
if (planned && viewers.length) viewers[0].plan = new PlanPage(viewers[0], JSON.parse(planned.textContent));
