// Drawing of a scene with WebGL2: opaque surfaces, glints, then transparent surfaces.

const CLIPPED = `
uniform vec3 u_low, u_high;
bool is_cut(vec3 p) { return any(lessThan(p, u_low)) || any(greaterThan(p, u_high)); }
`;

const SURFACE_VERTEX = `#version 300 es
in vec3 a_position; in vec3 a_normal; in float a_value; in float a_shade;
uniform mat4 u_matrix;
out vec3 v_position; out vec3 v_normal; out float v_value; out float v_shade;
void main() {
  v_position = a_position; v_normal = a_normal; v_value = a_value; v_shade = a_shade;
  gl_Position = u_matrix * vec4(a_position, 1.0);
}`;

// The lights are those of the pictures of the report. Sharp corners (30 degrees, as there) get the
// normal of the facet. The inside of a closed surface that is cut open is hatched.
const SURFACE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_position; in vec3 v_normal; in float v_value; in float v_shade;
uniform sampler2D u_map; uniform vec3 u_colour; uniform bool u_mapped, u_closed;
uniform float u_opacity; uniform mat3 u_axes; uniform vec3 u_cut; uniform float u_pixel;
out vec4 colour;
${CLIPPED}
vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }
void main() {
  if (is_cut(v_position)) discard;
  vec3 flat_normal = normalize(cross(dFdx(v_position), dFdy(v_position)));
  if (!gl_FrontFacing && u_closed) {
    float stripe = mod(gl_FragCoord.x + gl_FragCoord.y, 9.0 * u_pixel) / u_pixel;
    vec3 cut = u_cut * (stripe < 1.4 ? 0.72 : 1.0);
    colour = vec4(cut * u_opacity, u_opacity);
    return;
  }
  // facing the viewer, as the derivatives do
  vec3 normal = normalize(v_normal) * (gl_FrontFacing ? 1.0 : -1.0);
  normal = normalize(mix(flat_normal, normal, smoothstep(0.6, 0.86, dot(normal, flat_normal))));
  vec3 local = u_axes * normal;
  float key = max(dot(local, vec3(-0.413, 0.596, 0.688)), 0.0);
  float fill = max(dot(local, vec3(0.843, -0.105, 0.527)), 0.0);
  float light = (0.62 * key + 0.2 * fill + 0.36) * (0.35 + 0.65 * v_shade);
  vec3 albedo = linear(u_mapped ? texture(u_map, vec2(v_value, 0.5)).rgb : u_colour);
  float gloss = 0.10 * pow(max(dot(local, normalize(vec3(-0.413, 0.596, 1.688))), 0.0), 40.0);
  vec3 lit = pow(clamp(1.15 * albedo * light + gloss, 0.0, 1.0), vec3(1.0 / 2.2));
  colour = vec4(lit * u_opacity, u_opacity);
}`;

const FLAT_VERTEX = `#version 300 es
in vec3 a_position;
uniform mat4 u_matrix;
out vec3 v_position;
void main() { v_position = a_position; gl_Position = u_matrix * vec4(a_position, 1.0); }`;

const FLAT_FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_position;
uniform vec4 u_paint;
out vec4 colour;
${CLIPPED}
void main() { if (is_cut(v_position)) discard; colour = vec4(u_paint.rgb * u_paint.a, u_paint.a); }`;

// A disc across each normal and a thin needle along it, both as triangles of one shape.
const GLINT_VERTEX = `#version 300 es
in vec3 a_shape; in vec3 a_center; in vec3 a_direction; in float a_value;
uniform mat4 u_matrix; uniform float u_radius; uniform sampler2D u_map;
out vec3 v_position; out vec3 v_colour;
void main() {
  vec3 n = normalize(a_direction);
  vec3 s = normalize(cross(abs(n.z) < 0.9 ? vec3(0.0, 0.0, 1.0) : vec3(1.0, 0.0, 0.0), n));
  vec3 t = cross(n, s);
  v_position = a_center + u_radius * (a_shape.x * s + a_shape.y * t + a_shape.z * n);
  v_colour = texture(u_map, vec2(a_value, 0.5)).rgb * (a_shape.z > 0.0 ? 0.8 : 1.0);
  gl_Position = u_matrix * vec4(v_position, 1.0);
}`;

const GLINT_FRAGMENT = `#version 300 es
precision highp float;
in vec3 v_position; in vec3 v_colour;
uniform float u_opacity;
out vec4 colour;
${CLIPPED}
void main() { if (is_cut(v_position)) discard; colour = vec4(v_colour * u_opacity, u_opacity); }`;

// A cut through a volume; weak values are transparent.
const SLICE_FRAGMENT = `#version 300 es
precision highp float; precision highp sampler3D;
in vec3 v_position;
uniform sampler3D u_volume; uniform sampler2D u_map; uniform vec3 u_origin, u_span; uniform bool u_opaque;
out vec4 colour;
void main() {
  float level = texture(u_volume, ((v_position - u_origin) / u_span).zyx).r;
  float alpha = 0.92 * (u_opaque ? 1.0 : smoothstep(0.02, 0.4, level));
  colour = vec4(texture(u_map, vec2(level, 0.5)).rgb * alpha, alpha);
}`;

function glintShape() {
  const points = [];
  const sides = 10;
  for (let k = 0; k < sides; k++) {
    const [a, b] = [k, k + 1].map((i) => (2 * Math.PI * i) / sides);
    points.push(0, 0, 0, Math.cos(a), Math.sin(a), 0, Math.cos(b), Math.sin(b), 0);
  }
  for (const [x, y] of [[0.16, 0], [0, 0.16]]) points.push(x, y, 0, -x, -y, 0, 0, 0, 4);
  return new Float32Array(points);
}

// Box and antennas are not cut with the content.
const uncut = (view) => ({ ...view, clip: { low: [-1e9, -1e9, -1e9], high: [1e9, 1e9, 1e9] } });

class Painter {
  constructor(canvas, scene) {
    const gl = canvas.getContext("webgl2", { antialias: true, premultipliedAlpha: true });
    if (!gl) throw new Error("no WebGL2");
    this.gl = gl;
    this.scene = scene;
    this.programs = {
      surface: this.program(SURFACE_VERTEX, SURFACE_FRAGMENT),
      flat: this.program(FLAT_VERTEX, FLAT_FRAGMENT),
      glint: this.program(GLINT_VERTEX, GLINT_FRAGMENT),
      slice: this.program(FLAT_VERTEX, SLICE_FRAGMENT),
    };
    this.drawn = new Map(scene.meshes.map((mesh) => [mesh, this.prepareMesh(mesh)]));
    this.glints = scene.glints && this.prepareGlints(scene.glints);
    this.planes = scene.planes && this.preparePlanes(scene.planes);
    this.faces = scene.faces && this.prepareFaces(scene.faces);
    this.volumes = new Map(scene.volumes.map((volume) => [volume, this.prepareVolume(volume)]));
  }

  program(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "a_position"); // one vertex array serves two programs
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error("shaders do not compile");
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const { name } = gl.getActiveUniform(program, i);
      uniforms[name] = gl.getUniformLocation(program, name);
    }
    return { program, uniforms };
  }

  buffer(data, target = this.gl.ARRAY_BUFFER) {
    const made = this.gl.createBuffer();
    this.gl.bindBuffer(target, made);
    this.gl.bufferData(target, data, this.gl.STATIC_DRAW);
    return made;
  }

  // Vertex array of (attribute, data, numbers per vertex, whether one per instance).
  array(program, columns, indices) {
    const gl = this.gl;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = {};
    for (const [name, data, size, each] of columns) {
      const at = gl.getAttribLocation(this.programs[program].program, name);
      buffers[name] = this.buffer(data);
      if (at < 0) continue;
      gl.enableVertexAttribArray(at);
      const type = data instanceof Uint8Array ? gl.UNSIGNED_BYTE : gl.FLOAT;
      gl.vertexAttribPointer(at, size, type, type === gl.UNSIGNED_BYTE, 0, 0);
      if (each) gl.vertexAttribDivisor(at, 1);
    }
    if (indices) this.buffer(indices, gl.ELEMENT_ARRAY_BUFFER);
    gl.bindVertexArray(null);
    return { array, buffers };
  }

  map(colours, smooth) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    const bytes = new Uint8Array(colours.flatMap((hex) => [...rgb(hex).map((c) => Math.round(255 * c)), 255]));
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, colours.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    const filter = smooth ? gl.LINEAR : gl.NEAREST;
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, filter);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(gl.TEXTURE_2D, name, gl.CLAMP_TO_EDGE);
    }
    return texture;
  }

  prepareMesh(mesh) {
    const nothing = new Float32Array(mesh.positions.length / 3);
    const columns = [
      ["a_position", mesh.positions, 3],
      ["a_normal", mesh.normals, 3],
      ["a_value", nothing, 1],
      ["a_shade", mesh.shade, 1],
    ];
    const made = this.array("surface", columns, mesh.indices);
    const edges = mesh.edges && mesh.edges.length ? this.array("flat", [["a_position", mesh.edges, 3]]) : null;
    return { ...made, edges, texture: null, colour: rgb(mesh.colour) };
  }

  // Colour a mesh by one of its attributes, or uniformly.
  paint(mesh, attribute) {
    const gl = this.gl;
    const drawn = this.drawn.get(mesh);
    gl.deleteTexture(drawn.texture);
    drawn.texture = attribute ? this.map(attribute.colours, !attribute.classes) : null;
    if (!attribute) return;
    const values = Float32Array.from(attribute.values, (value) => onScale(attribute, value));
    gl.bindBuffer(gl.ARRAY_BUFFER, drawn.buffers.a_value);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
  }

  // Take over positions that changed.
  place(mesh) {
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.drawn.get(mesh).buffers.a_position);
    this.gl.bufferSubData(this.gl.ARRAY_BUFFER, 0, mesh.positions);
  }

  prepareGlints(glints) {
    const shape = glintShape();
    const columns = [
      ["a_shape", shape, 3],
      ["a_center", glints.positions, 3, true],
      ["a_direction", glints.normals, 3, true],
      ["a_value", Float32Array.from(glints.values, (value) => onScale(glints, value)), 1, true],
    ];
    const made = this.array("glint", columns);
    return { ...made, n: shape.length / 3, count: glints.values.length, texture: this.map(glints.colours, true) };
  }

  preparePlanes({ corners }) {
    const fill = [];
    const lines = [];
    for (let p = 0; p < corners.length; p += 12) {
      const [a, b, c, d] = [0, 3, 6, 9].map((k) => [...corners.slice(p + k, p + k + 3)]);
      fill.push(...a, ...b, ...c, ...a, ...c, ...d);
      lines.push(...a, ...b, ...b, ...c, ...c, ...d, ...d, ...a);
    }
    const made = (list) => ({ ...this.array("flat", [["a_position", new Float32Array(list), 3]]), n: list.length / 3 });
    return { fill: made(fill), lines: made(lines) };
  }

  // Seen faces are filled and framed, the others only framed, with dashes.
  prepareFaces(faces) {
    return faces.values.map((sigma, n) => {
      const corners = [0, 3, 6, 9].map((k) => [...faces.corners.slice(12 * n + k, 12 * n + k + 3)]);
      const [a, b, c, d] = corners;
      const middle = [0, 1, 2].map((k) => (a[k] + c[k]) / 2);
      const inner = corners.map((corner) => plus(middle, plus(corner, middle, -1), sigma === null ? 0.97 : 1));
      const dashes = sigma === null ? 25 : 1;
      const lines = inner.flatMap((from, k) => {
        const along = plus(inner[(k + 1) % 4], from, -1);
        return [...Array(Math.ceil(dashes / 2)).keys()].flatMap((i) => [
          ...plus(from, along, (2 * i) / dashes), ...plus(from, along, (2 * i + 1) / dashes)]);
      });
      const made = (list) => ({ ...this.array("flat", [["a_position", new Float32Array(list), 3]]), n: list.length / 3 });
      const at = sigma === null ? 1 : onScale(faces, sigma) * (faces.colours.length - 1);
      const [low, high] = [Math.floor(at), Math.ceil(at)].map((i) => rgb(faces.colours[i]));
      const colour = sigma === null ? [0.5, 0.5, 0.5] : low.map((v, i) => v + (at % 1) * (high[i] - v));
      return { fill: sigma === null ? null : made([...a, ...b, ...c, ...a, ...c, ...d]), lines: made(lines), colour };
    });
  }

  prepareVolume({ values, shape, colours }) {
    const gl = this.gl;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_3D, texture);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, shape[2], shape[1], shape[0], 0, gl.RED, gl.UNSIGNED_BYTE, values);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_3D, name, gl.LINEAR);
    for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T, gl.TEXTURE_WRAP_R]) {
      gl.texParameteri(gl.TEXTURE_3D, name, gl.CLAMP_TO_EDGE);
    }
    return { texture, map: this.map(colours, true), quad: this.array("flat", [["a_position", new Float32Array(18), 3]]) };
  }

  // slice: volume, axis, at [mm].
  drawSlice({ volume, axis, at }, seen) {
    const gl = this.gl;
    const { texture, map, quad } = this.volumes.get(volume);
    const low = volume.origin.map((value) => value - volume.spacing / 2);
    const span = volume.shape.map((n) => n * volume.spacing);
    const corner = (u, v) => {
      const [first, second] = [0, 1, 2].filter((k) => k !== axis);
      const point = [...low];
      point[axis] = at;
      point[first] += u * span[first];
      point[second] += v * span[second];
      return point;
    };
    const [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
    gl.bindBuffer(gl.ARRAY_BUFFER, quad.buffers.a_position);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([...a, ...b, ...c, ...a, ...c, ...d]), gl.STREAM_DRAW);
    const uniforms = this.use("slice", uncut(seen));
    gl.uniform3fv(uniforms.u_origin, low);
    gl.uniform3fv(uniforms.u_span, span);
    gl.uniform1i(uniforms.u_opaque, volume.opaque ? 1 : 0);
    gl.uniform1i(uniforms.u_volume, 1);
    gl.uniform1i(uniforms.u_map, 0);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_3D, texture);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, map);
    gl.bindVertexArray(quad.array);
    gl.drawArrays(gl.TRIANGLES, 0, 6);
  }

  use(name, view) {
    const { program, uniforms } = this.programs[name];
    const gl = this.gl;
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.u_matrix, false, view.matrix);
    gl.uniform3fv(uniforms.u_low, view.clip.low);
    gl.uniform3fv(uniforms.u_high, view.clip.high);
    return uniforms;
  }

  // view: matrix, axes (camera), clip (low, high), cut (colour), pixel (device pixels per pixel),
  // slice, held (planes to be shown) and wiper, the share of the width left of which the content is
  // shown, and right of which what it is compared with.
  draw(view) {
    const gl = this.gl;
    const [width, height] = [gl.canvas.width, gl.canvas.height];
    gl.viewport(0, 0, width, height);
    gl.disable(gl.SCISSOR_TEST);
    gl.depthMask(true);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    const shown = this.scene.meshes.filter((mesh) => mesh.visible && mesh.opacity > 0);
    if (view.wiper === null) this.drawLayers(shown, view);
    else {
      const at = Math.round(view.wiper * width);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, 0, at, height);
      this.drawLayers(shown.filter((mesh) => !mesh.reference), view);
      gl.scissor(at, 0, width - at, height);
      const others = this.scene.meshes.filter((mesh) => mesh.reference);
      this.drawLayers([...others, ...shown.filter((mesh) => mesh.walls)], view, true);
    }
    gl.bindVertexArray(null);
  }

  drawLayers(shown, view, opaque = false) {
    const gl = this.gl;
    const solid = shown.filter((mesh) => (mesh.opacity >= 1 || opaque) && !mesh.walls);
    gl.disable(gl.BLEND);
    for (const mesh of solid) this.drawSurface(mesh, view, opaque ? 1 : mesh.opacity);
    const { glints, planes, faces } = this.scene;
    if (glints && glints.visible && glints.opacity > 0) this.drawGlints(glints, view);
    gl.enable(gl.BLEND);
    for (const mesh of shown) {
      if (solid.includes(mesh) || mesh.walls) continue;
      // only the nearest layer
      gl.colorMask(false, false, false, false);
      this.drawSurface(mesh, view, mesh.opacity);
      gl.colorMask(true, true, true, true);
      this.drawSurface(mesh, view, mesh.opacity);
    }
    if (view.slice) this.drawSlice(view.slice, view);
    gl.depthMask(false);
    if (planes && planes.visible && planes.opacity > 0) this.drawPlanes(planes, view);
    else if (planes) for (const n of view.held) this.drawPlanes({ ...planes, opacity: 1 }, view, n);
    if (faces && faces.visible && faces.opacity > 0) this.drawFaces(faces, view);
    for (const mesh of shown) if (mesh.walls) this.drawWalls(mesh, view);
    gl.depthMask(true);
  }

  drawSurface(mesh, view, opacity) {
    const gl = this.gl;
    const drawn = this.drawn.get(mesh);
    const uniforms = this.use("surface", view);
    gl.uniformMatrix3fv(uniforms.u_axes, false, view.columns);
    gl.uniform1f(uniforms.u_opacity, opacity);
    gl.uniform1f(uniforms.u_pixel, view.pixel);
    gl.uniform3fv(uniforms.u_colour, drawn.colour);
    gl.uniform3fv(uniforms.u_cut, view.cut);
    gl.uniform1i(uniforms.u_mapped, drawn.texture ? 1 : 0);
    gl.uniform1i(uniforms.u_closed, mesh.closed ? 1 : 0);
    gl.bindTexture(gl.TEXTURE_2D, drawn.texture);
    gl.bindVertexArray(drawn.array);
    gl.drawElements(gl.TRIANGLES, mesh.indices.length, gl.UNSIGNED_INT, 0);
  }

  paintFlat({ array }, mode, n, paint, view, first = 0) {
    const gl = this.gl;
    const uniforms = this.use("flat", view);
    gl.uniform4fv(uniforms.u_paint, paint);
    gl.bindVertexArray(array);
    gl.drawArrays(mode, first, n);
  }

  // All edges, and only the nearest layer of the walls, so that few layers cover the content.
  drawWalls(mesh, seen) {
    const view = uncut(seen);
    const gl = this.gl;
    const drawn = this.drawn.get(mesh);
    if (drawn.edges) {
      const paint = [...drawn.colour.map((c) => 0.6 * c), Math.min(1, 3.5 * mesh.opacity)];
      this.paintFlat(drawn.edges, gl.LINES, mesh.edges.length / 3, paint, view);
    }
    const uniforms = this.use("flat", view);
    gl.uniform4fv(uniforms.u_paint, [...drawn.colour, mesh.opacity]);
    gl.bindVertexArray(drawn.array);
    for (const pass of [false, true]) {
      gl.colorMask(pass, pass, pass, pass);
      gl.depthMask(!pass);
      gl.drawElements(gl.TRIANGLES, mesh.indices.length, gl.UNSIGNED_INT, 0);
    }
  }

  drawGlints(glints, view) {
    const gl = this.gl;
    const uniforms = this.use("glint", view);
    gl.uniform1f(uniforms.u_radius, glints.radius);
    gl.uniform1f(uniforms.u_opacity, 1);
    gl.bindTexture(gl.TEXTURE_2D, this.glints.texture);
    gl.bindVertexArray(this.glints.array);
    gl.drawArraysInstanced(gl.TRIANGLES, 0, this.glints.n, this.glints.count);
  }

  // All planes, or the one of a number.
  drawPlanes(planes, view, number = null) {
    const gl = this.gl;
    const whole = uncut(view);
    const colour = rgb(planes.colour);
    const drawn = (part, mode, each, opacity) => {
      const [n, first] = number === null ? [part.n, 0] : [each, each * number];
      if (first + n <= part.n) this.paintFlat(part, mode, n, [...colour, opacity], whole, first);
    };
    drawn(this.planes.fill, gl.TRIANGLES, 6, 0.35 * planes.opacity);
    drawn(this.planes.lines, gl.LINES, 8, planes.opacity);
  }

  drawFaces(faces, view) {
    const gl = this.gl;
    const whole = uncut(view);
    for (const { fill, lines, colour } of this.faces) {
      if (fill) this.paintFlat(fill, gl.TRIANGLES, fill.n, [...colour, 0.6 * faces.opacity], whole);
      const dark = colour.map((c) => 0.6 * c);
      this.paintFlat(lines, gl.LINES, lines.n, [...dark, Math.min(1, 3.5 * faces.opacity)], whole);
    }
  }
}
