// Vectors, cameras and triangles. Lengths in millimetres.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b, scale = 1) => [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const norm = (a) => Math.sqrt(dot(a, a));
const unit = (a) => {
  const length = norm(a) || 1;
  return [a[0] / length, a[1] / length, a[2] / length];
};
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

// Camera on a sphere around a target; z is up. The tangent of half the field of view is the same with
// and without perspective, so that the target keeps its size when that is switched.
const HALF_VIEW = Math.tan((28 * Math.PI) / 360);

class Camera {
  constructor() {
    this.target = [0, 0, 0];
    this.azimuth = 0;
    this.elevation = 0;
    this.distance = 100;
    this.orthographic = false;
  }

  // Rows: right, up, towards the viewer.
  axes() {
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    const toward = [ce * ca, ce * sa, se];
    const right = [-sa, ca, 0];
    return [right, cross(toward, right), toward];
  }

  eye() {
    return plus(this.target, this.axes()[2], this.distance);
  }

  halfHeight() {
    return this.distance * HALF_VIEW;
  }

  // Column-major matrix from millimetres to clip coordinates; reach: radius of everything shown.
  matrix(aspect, reach) {
    const [right, up, toward] = this.axes();
    const half = this.halfHeight();
    const far = this.distance + reach;
    const near = this.orthographic ? this.distance - reach : Math.max(far / 2000, this.distance - reach);
    const origin = this.eye();
    const rows = [right, up, toward].map((axis) => [...axis, -dot(axis, origin)]);
    const [sx, sy] = [1 / (half * aspect), 1 / half];
    const depth = 2 / (near - far);
    const out = new Float32Array(16);
    for (let column = 0; column < 4; column++) {
      const [x, y, z] = [rows[0][column], rows[1][column], rows[2][column]];
      const last = column === 3 ? 1 : 0;
      if (this.orthographic) {
        out[4 * column] = sx * x;
        out[4 * column + 1] = sy * y;
        out[4 * column + 2] = depth * z + last * (far + near) / (near - far);
        out[4 * column + 3] = last;
      } else {
        out[4 * column] = sx * this.distance * x;
        out[4 * column + 1] = sy * this.distance * y;
        out[4 * column + 2] = ((far + near) / (near - far)) * z + last * (2 * far * near) / (near - far);
        out[4 * column + 3] = -z;
      }
    }
    return out;
  }

  // Ray through a point of the picture, both coordinates from -1 to 1, y up.
  ray(x, y, aspect, reach) {
    const [right, up, toward] = this.axes();
    const half = this.halfHeight();
    const across = plus(plus([0, 0, 0], right, x * half * aspect), up, y * half);
    if (this.orthographic) {
      const origin = plus(plus(this.target, across), toward, this.distance + reach);
      return { origin, direction: plus([0, 0, 0], toward, -1) };
    }
    return { origin: this.eye(), direction: unit(plus(across, toward, -this.distance)) };
  }

  // Position of a point in the picture, -1 to 1, y up; null behind the viewer.
  project(point, aspect) {
    const [right, up, toward] = this.axes();
    const offset = plus(point, this.target, -1);
    const half = this.halfHeight();
    const ahead = this.distance - dot(offset, toward);
    if (!this.orthographic && ahead <= 0) return null;
    const shrink = this.orthographic ? 1 : this.distance / ahead;
    return [(shrink * dot(offset, right)) / (half * aspect), (shrink * dot(offset, up)) / half];
  }
}

// Area-weighted normals of vertices.
function vertexNormals(positions, indices) {
  const normals = new Float32Array(positions.length);
  const corner = (i) => [positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]];
  for (let f = 0; f < indices.length; f += 3) {
    const a = corner(indices[f]);
    const n = cross(plus(corner(indices[f + 1]), a, -1), plus(corner(indices[f + 2]), a, -1));
    for (let k = 0; k < 3; k++) {
      for (let d = 0; d < 3; d++) normals[3 * indices[f + k] + d] += n[d];
    }
  }
  for (let v = 0; v < normals.length; v += 3) {
    const length = Math.hypot(normals[v], normals[v + 1], normals[v + 2]) || 1;
    for (let d = 0; d < 3; d++) normals[v + d] /= length;
  }
  return normals;
}

// Line segments along edges where the surface bends by more than 30 degrees, or ends.
function sharpEdges(positions, indices) {
  const edges = new Map();
  const corner = (i) => [positions[3 * i], positions[3 * i + 1], positions[3 * i + 2]];
  for (let f = 0; f < indices.length; f += 3) {
    const a = corner(indices[f]);
    const normal = unit(cross(plus(corner(indices[f + 1]), a, -1), plus(corner(indices[f + 2]), a, -1)));
    for (let k = 0; k < 3; k++) {
      const [i, j] = [indices[f + k], indices[f + ((k + 1) % 3)]];
      const key = i < j ? `${i} ${j}` : `${j} ${i}`;
      const found = edges.get(key);
      if (found) found.sharp = dot(found.normal, normal) < 0.866;
      else edges.set(key, { i, j, normal, sharp: true });
    }
  }
  const kept = [...edges.values()].filter((edge) => edge.sharp);
  return new Float32Array(kept.flatMap(({ i, j }) => [...corner(i), ...corner(j)]));
}

// Tolerance at edges, in barycentric coordinates: rounding must not let a ray pass between triangles.
const EDGE = 1e-6;

// First triangle hit by a ray (Moeller and Trumbore): its number, barycentric weights and point, or
// null. `inside` is whether a point is not cut away.
function firstHit({ positions, indices }, { origin, direction }, inside) {
  let best = null;
  const [ox, oy, oz] = origin;
  const [dx, dy, dz] = direction;
  for (let f = 0; f < indices.length; f += 3) {
    const [a, b, c] = [3 * indices[f], 3 * indices[f + 1], 3 * indices[f + 2]];
    const [ax, ay, az] = [positions[a], positions[a + 1], positions[a + 2]];
    const [ux, uy, uz] = [positions[b] - ax, positions[b + 1] - ay, positions[b + 2] - az];
    const [vx, vy, vz] = [positions[c] - ax, positions[c + 1] - ay, positions[c + 2] - az];
    const [px, py, pz] = [dy * vz - dz * vy, dz * vx - dx * vz, dx * vy - dy * vx];
    const determinant = ux * px + uy * py + uz * pz;
    if (determinant === 0) continue;
    const [tx, ty, tz] = [ox - ax, oy - ay, oz - az];
    const u = (tx * px + ty * py + tz * pz) / determinant;
    if (u < -EDGE || u > 1 + EDGE) continue;
    const [qx, qy, qz] = [ty * uz - tz * uy, tz * ux - tx * uz, tx * uy - ty * ux];
    const v = (dx * qx + dy * qy + dz * qz) / determinant;
    if (v < -EDGE || u + v > 1 + EDGE) continue;
    const t = (vx * qx + vy * qy + vz * qz) / determinant;
    if (t <= 0 || (best && t >= best.t)) continue;
    const point = [ox + t * dx, oy + t * dy, oz + t * dz];
    if (inside(point)) best = { t, point, face: f / 3, weights: [1 - u - v, u, v] };
  }
  return best;
}
