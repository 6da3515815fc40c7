// Decoding of the scene: from quantised numbers to arrays in millimetres.

const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, i1: Int8Array };

// Array of {"type": "u2", "data": base64}; little-endian, like the machine.
function numbers({ type, data }) {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  return new TYPES[type](bytes.buffer);
}

// Values low + step * integer, with one pair (low, step) for each column.
function stretched({ low, step, values }) {
  const whole = numbers(values);
  const out = new Float32Array(whole.length);
  const columns = low.length;
  for (let i = 0; i < out.length; i++) out[i] = low[i % columns] + step[i % columns] * whole[i];
  return out;
}

function readMesh(raw) {
  const positions = stretched(raw.positions);
  const indices = Uint32Array.from(numbers(raw.indices));
  const attributes = raw.attributes.map((attribute) => ({ ...attribute, values: stretched(attribute.values) }));
  return {
    ...raw,
    positions,
    home: positions.slice(), // before groups were moved apart
    groups: raw.groups ? numbers(raw.groups) : null,
    indices,
    attributes,
    normals: vertexNormals(positions, indices),
    shade: raw.shade ? numbers(raw.shade) : new Uint8Array(positions.length / 3).fill(255),
    edges: raw.edges ? sharpEdges(positions, indices) : null,
  };
}

function readScene(raw) {
  const glints = raw.glints && {
    ...raw.glints,
    positions: stretched(raw.glints.positions),
    normals: stretched(raw.glints.normals),
    values: stretched(raw.glints.values),
    poses: numbers(raw.glints.poses),
  };
  const corners = (layer) => layer && { ...layer, corners: new Float32Array(layer.corners.flat(2)) };
  const [planes, faces] = [corners(raw.planes), corners(raw.faces)];
  const volumes = (raw.volumes || []).map((volume) => ({ ...volume, values: numbers(volume.values) }));
  return { ...raw, meshes: raw.meshes.map(readMesh), glints, planes, faces, volumes };
}

// Glints that hold a point of a surface: near to it, with its normal; the nearest first.
function holdersOf(glints, point, normal) {
  const found = [];
  for (let i = 0; i < glints.values.length; i++) {
    const [at, along] = [glints.positions, glints.normals].map((list) => [...list.slice(3 * i, 3 * i + 3)]);
    const distance = norm(plus(at, point, -1));
    if (distance > glints.reach || dot(unit(along), normal) < glints.cosine) continue;
    found.push({ at, distance, pose: glints.poses[i], decibels: glints.values[i] });
  }
  return found.sort((a, b) => a.distance - b.distance);
}

// Bounding box of points given as x, y, z, x, y, z, ...
function boundsOf(lists) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (const list of lists) {
    for (let i = 0; i < list.length; i++) {
      low[i % 3] = Math.min(low[i % 3], list[i]);
      high[i % 3] = Math.max(high[i % 3], list[i]);
    }
  }
  return { low, high };
}

const rgb = (hex) => [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);

// Position of a value on the scale of its attribute, 0 to 1.
function onScale(attribute, value) {
  if (attribute.classes) return (value % attribute.colours.length + 0.5) / attribute.colours.length;
  return clamp((value - attribute.range[0]) / (attribute.range[1] - attribute.range[0]), 0, 1);
}

// Text of a number, zero without a sign.
const millimetres = (value, digits = 1) => value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1");

// Text of a value, with its unit.
function formatted(attribute, value) {
  if (attribute.classes) return attribute.classes[clamp(Math.round(value), 0, attribute.classes.length - 1)];
  const digits = attribute.digits;
  if (attribute.sides && Math.abs(value) >= 0.5 * 10 ** -digits) {
    const side = value < 0 ? attribute.sides[0] : attribute.sides[1];
    return `${Math.abs(value).toFixed(digits)} ${attribute.unit} ${side}`;
  }
  return `${millimetres(value, digits)}${attribute.unit ? ` ${attribute.unit}` : ""}`;
}
