"use strict";
// The page of `jaxfem view`: one script, no network. Places come as 16-bit shares of a box, values as 8-bit shares of
// their range; both go to the graphics card as they are.

function bytesOf(text) {
  const raw = atob(text), bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}

const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f4: Float32Array };

function decoded(array) {
  return array ? new TYPES[array.type](bytesOf(array.data).buffer) : null;
}

// The last frame at or before a time.
function frameAt(times, time) {
  let low = 0, high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle; else high = middle - 1;
  }
  return low;
}

// Viridis, by polynomials of degree 6 in each channel (Matt Zucker, public domain).
const VIRIDIS = [
  [0.2777273272, 0.0054073445, 0.3340998053], [0.1050930431, 1.4046135299, 1.3845901626],
  [-0.3308618287, 0.2148475595, 0.0950951630], [-4.6342304990, -5.7991009734, -19.3324409563],
  [6.2282699363, 14.1799333668, 56.6905526007], [4.7763849980, -13.7451453777, -65.3530326334],
  [-5.4354558559, 4.6458526122, 26.3124352496]];

function viridis(share) {
  const t = Math.min(1, Math.max(0, share)), rgb = [0, 0, 0];
  for (let k = VIRIDIS.length - 1; k >= 0; k--) for (let c = 0; c < 3; c++) rgb[c] = rgb[c] * t + VIRIDIS[k][c];
  return rgb.map((c) => Math.min(1, Math.max(0, c)));
}

// A number with a prefix that suits its unit.
function measured(value, unit) {
  if (!unit || !isFinite(value) || value === 0) return String(Number(value.toPrecision(3))) + (unit ? " " + unit : "");
  const steps = [[1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];
  const [size, prefix] = steps.find(([size]) => Math.abs(value) >= size) || steps[steps.length - 1];
  return Number((value / size).toPrecision(3)) + " " + prefix + unit;
}

// Round numbers that divide a range into about so many parts.
function ticks(low, high, parts) {
  const raw = (high - low) / parts || 1, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((s) => s * power >= raw) * power, found = [];
  for (let value = Math.ceil(low / step - 1e-9) * step; value <= high + 1e-9 * step; value += step) found.push(value);
  return found;
}

function multiply(a, b) {  // 4x4, columns first
  const out = new Float32Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++)
    for (let k = 0; k < 4; k++) out[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return out;
}

// From the world, z up, to the screen.
function viewMatrix(camera, aspect) {
  const { yaw, pitch, distance, target, size } = camera;
  const cy = Math.cos(yaw), sy = Math.sin(yaw), cp = Math.cos(pitch), sp = Math.sin(pitch);
  const right = [cy, sy, 0], up = [-sp * sy, sp * cy, cp];
  const toward = [right[1] * up[2] - right[2] * up[1], right[2] * up[0] - right[0] * up[2],
    right[0] * up[1] - right[1] * up[0]];
  const along = (axis) => -(axis[0] * target[0] + axis[1] * target[1] + axis[2] * target[2]);
  const view = new Float32Array([right[0], up[0], toward[0], 0, right[1], up[1], toward[1], 0,
    right[2], up[2], toward[2], 0, along(right), along(up), along(toward) - distance, 1]);
  const near = Math.max(distance - 2 * size, 1e-3 * size), far = distance + 4 * size, f = 1 / Math.tan(0.35);
  const project = new Float32Array([f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1,
    0, 0, 2 * far * near / (near - far), 0]);
  return { matrix: multiply(project, view), right, up, toward };
}

const VERTEX = `#version 300 es
in vec3 place; in vec3 rest; in float value;
uniform mat4 view; uniform vec3 low, span; uniform int mode; uniform float top, size;
out vec3 world; out float share;
void main() {
  world = low + place * span;
  share = mode == 1 ? length(world - rest) / top : value;
  gl_Position = view * vec4(world, 1.0);
  gl_PointSize = size;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
in vec3 world; in float share;
uniform int mode, lit; uniform vec3 colour, light; uniform vec3 map[7];
out vec4 seen;
void main() {
  vec3 own = colour;
  if (mode > 0) {
    float t = clamp(share, 0.0, 1.0);
    own = vec3(0.0);
    for (int k = 6; k >= 0; k--) own = own * t + map[k];
  }
  if (lit == 1) {
    vec3 normal = normalize(cross(dFdx(world), dFdy(world)));
    own *= 0.45 + 0.55 * abs(dot(normal, light));
  }
  seen = vec4(own, 1.0);
}`;

function program(gl) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(made));
  return made;
}

// A part of the scene on the graphics card. `starts`: first vertex of each frame; equal ones stand still.
class Mesh {
  constructor(gl, given) {
    Object.assign(this, { gl, name: given.name, kind: given.kind, colour: given.colour, unit: given.unit });
    this.places = decoded(given.places);
    this.starts = given.starts;
    this.rest = decoded(given.rest);
    this.fields = (given.fields || []).map((f) => ({ ...f, data: decoded(f.values) }));
    this.shown = true;
    this.buffers = { place: gl.createBuffer(), rest: gl.createBuffer(), value: gl.createBuffer() };
    if (this.rest) {
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.rest);
      gl.bufferData(gl.ARRAY_BUFFER, this.rest, gl.STATIC_DRAW);
    }
    const index = decoded(given.index);
    this.count = index ? index.length : 0;
    if (index) {
      this.index = gl.createBuffer();
      this.wide = index instanceof Uint32Array;
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.index);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, index, gl.STATIC_DRAW);
    }
  }

  draw(uniform, attribute, frame, colouring) {
    const gl = this.gl, first = this.starts[frame], end = this.starts[frame + 1];
    const still = this.starts.length === 2;
    const [from, to] = still ? [0, this.starts[1]] : [first, end];
    if (!this.shown || to <= from) return;
    const field = this.fields.find((f) => f.name === colouring);
    const mode = colouring === "displacement" && this.rest ? 1 : field ? 2 : 0;
    gl.uniform1i(uniform.mode, mode);
    gl.uniform1i(uniform.lit, this.kind === "triangle" ? 1 : 0);
    gl.uniform3fv(uniform.colour, this.colour);
    gl.uniform1f(uniform.size, this.kind === "vertex" ? 7 : 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers.place);
    gl.bufferData(gl.ARRAY_BUFFER, this.places.subarray(3 * from, 3 * to), gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(attribute.place);
    gl.vertexAttribPointer(attribute.place, 3, gl.UNSIGNED_SHORT, true, 0, 0);
    for (const [name, on] of [["rest", mode === 1], ["value", mode === 2]]) {
      if (!on) { gl.disableVertexAttribArray(attribute[name]); continue; }
      gl.bindBuffer(gl.ARRAY_BUFFER, this.buffers[name]);
      if (name === "value") gl.bufferData(gl.ARRAY_BUFFER, field.data.subarray(from, to), gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(attribute[name]);
      if (name === "rest") gl.vertexAttribPointer(attribute.rest, 3, gl.FLOAT, false, 0, 0);
      else gl.vertexAttribPointer(attribute.value, 1, gl.UNSIGNED_BYTE, true, 0, 0);
    }
    const how = { triangle: gl.TRIANGLES, line: gl.LINES, vertex: gl.POINTS }[this.kind];
    if (!this.index) { gl.drawArrays(how, 0, to - from); return; }
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.index);
    gl.drawElements(how, this.count, this.wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT, 0);
  }
}

const LINES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#999999"];

class Graph {
  constructor(given, seek) {
    this.given = given;
    this.figure = document.createElement("figure");
    this.canvas = document.createElement("canvas");
    const caption = document.createElement("figcaption");
    caption.append(given.title + " ");
    given.lines.forEach((line, i) => {
      const key = document.createElement("span"), dash = document.createElement("i");
      key.className = "key";
      dash.style.background = LINES[i % LINES.length];
      key.append(dash, line.name);
      caption.append(key);
    });
    this.figure.append(caption, this.canvas);
    this.canvas.addEventListener("pointerdown", (event) => {
      const { left, right } = this.frame(), x = event.offsetX;
      const share = Math.min(1, Math.max(0, (x - left) / (right - left)));
      seek(given.times[0] + share * (given.times[given.times.length - 1] - given.times[0]));
    });
  }

  frame() {
    return { left: 58, right: this.canvas.clientWidth - 8, top: 8, bottom: this.canvas.clientHeight - 20 };
  }

  draw(time) {
    const ratio = window.devicePixelRatio || 1, canvas = this.canvas;
    canvas.width = canvas.clientWidth * ratio;
    canvas.height = canvas.clientHeight * ratio;
    const pen = canvas.getContext("2d"), { times, lines, unit } = this.given, box = this.frame();
    pen.scale(ratio, ratio);
    const every = lines.flatMap((line) => line.values).filter(isFinite);
    let low = Math.min(...every), high = Math.max(...every);
    if (!(high > low)) { low -= 1e-9 + Math.abs(low) / 2; high += 1e-9 + Math.abs(high) / 2; }
    const first = times[0], last = times[times.length - 1] > first ? times[times.length - 1] : first + 1;
    const x = (t) => box.left + (t - first) / (last - first) * (box.right - box.left);
    const y = (v) => box.bottom - (v - low) / (high - low) * (box.bottom - box.top);
    const ink = getComputedStyle(document.body).color;
    pen.font = "11px system-ui, sans-serif";
    pen.fillStyle = ink;
    pen.strokeStyle = "#8884";
    pen.textAlign = "right";
    for (const value of ticks(low, high, 4)) {
      pen.beginPath(); pen.moveTo(box.left, y(value)); pen.lineTo(box.right, y(value)); pen.stroke();
      pen.fillText(measured(value, unit), box.left - 4, y(value) + 4);
    }
    pen.textAlign = "center";
    for (const value of ticks(first, last, 4)) pen.fillText(measured(value, "s"), x(value), box.bottom + 14);
    lines.forEach((line, i) => {
      pen.strokeStyle = LINES[i % LINES.length];
      pen.lineWidth = 1.6;
      pen.beginPath();
      line.values.forEach((value, k) => pen[k ? "lineTo" : "moveTo"](x(times[k]), y(value)));
      pen.stroke();
    });
    pen.strokeStyle = ink;
    pen.lineWidth = 1;
    pen.beginPath(); pen.moveTo(x(time), box.top); pen.lineTo(x(time), box.bottom); pen.stroke();
  }
}

class Player {
  constructor(data) {
    this.data = data;
    this.times = data.times;
    this.frame = 0;
    this.playing = false;
    this.clock = data.times[0];
    this.find = (id) => document.getElementById(id);
    this.canvas = this.find("scene");
    this.gl = this.canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("this browser shows no WebGL 2: the graphs still follow the slider");
    const gl = this.gl, made = program(gl), named = (names, get) => Object.fromEntries(names.map((n) => [n, get(n)]));
    gl.useProgram(made);
    this.uniform = named(["view", "low", "span", "mode", "top", "size", "lit", "colour", "light", "map"],
      (name) => gl.getUniformLocation(made, name));
    this.attribute = named(["place", "rest", "value"], (name) => gl.getAttribLocation(made, name));
    gl.uniform3fv(this.uniform.map, VIRIDIS.flat());
    gl.uniform3fv(this.uniform.low, data.low);
    gl.uniform3fv(this.uniform.span, data.span);
    gl.enable(gl.DEPTH_TEST);
    this.meshes = data.meshes.map((given) => new Mesh(gl, given));
    this.graphs = data.graphs.map((given) => new Graph(given, (time) => this.seek(frameAt(this.times, time))));
    this.resetView();
    this.controls();
  }

  resetView() {
    const { low, span, focus } = this.data;
    const size = focus ? focus.size : Math.hypot(...span);
    const target = focus ? [...focus.target] : low.map((v, i) => v + span[i] / 2);
    this.camera = { yaw: 0.6, pitch: 0.35, distance: 1.9 * size, size: Math.max(size, Math.hypot(...span)), target };
  }

  controls() {
    const { find, data } = this, on = (id, event, act) => find(id).addEventListener(event, act);
    find("about").textContent = data.about;
    for (const graph of this.graphs) find("graphs").append(graph.figure);
    find("frame").max = this.times.length - 1;
    const duration = this.times[this.times.length - 1] - this.times[0];
    // Fits whatever lasts a microsecond or a day: as fast as it was, or in about five seconds.
    const speeds = [["as it was", 1], ["half", 0.5], ["a tenth", 0.1], ["in 5 s", duration / 5 || 1]];
    speeds.forEach(([name, value]) => find("speed").append(new Option(name, value)));
    find("speed").value = duration > 1 && duration < 20 ? 1 : duration / 5 || 1;
    for (const name of ["plain", ...data.colourings.map((each) => each.name)]) find("colour").append(new Option(name));
    find("colour").value = data.colourings.length ? data.colourings[0].name : "plain";
    for (const mesh of this.meshes) {
      const label = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox"; box.checked = true;
      box.addEventListener("change", () => { mesh.shown = box.checked; this.draw(); });
      label.append(box, mesh.name + " ");
      find("parts").append(label);
    }
    on("play", "click", () => this.toggle());
    on("frame", "input", () => this.seek(Number(find("frame").value)));
    on("colour", "change", () => this.draw());
    on("reset", "click", () => { this.resetView(); this.draw(); });
    document.addEventListener("keydown", (event) => {
      if (event.target.tagName === "SELECT") return;
      if (event.key === " ") { event.preventDefault(); this.toggle(); }
      if (event.key === "ArrowRight") this.seek(this.frame + 1);
      if (event.key === "ArrowLeft") this.seek(this.frame - 1);
    });
    this.pointing();
    window.addEventListener("resize", () => this.draw());
  }

  pointing() {
    const canvas = this.canvas, held = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => held.delete(e.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      const last = held.get(event.pointerId);
      if (!last) return;
      const dx = event.clientX - last[0], dy = event.clientY - last[1], camera = this.camera;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (event.shiftKey || event.buttons === 4 || held.size > 1) {
        const { right, up } = viewMatrix(camera, 1), scale = 0.73 * camera.distance / canvas.clientHeight;
        camera.target = camera.target.map((v, i) => v - scale * dx * right[i] + scale * dy * up[i]);
      } else {
        camera.yaw -= 0.008 * dx;
        camera.pitch = Math.min(1.55, Math.max(-1.55, camera.pitch + 0.008 * dy));
      }
      this.draw();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.camera.distance *= Math.exp(0.001 * event.deltaY);
      this.draw();
    }, { passive: false });
  }

  toggle() {
    this.playing = !this.playing;
    this.find("play").textContent = this.playing ? "Pause" : "Play";
    if (!this.playing) return;
    if (this.frame === this.times.length - 1) this.seek(0);
    this.clock = this.times[this.frame];
    this.last = null;
    requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.playing) return;
    if (this.last !== null) this.clock += (now - this.last) / 1000 * Number(this.find("speed").value);
    this.last = now;
    const end = this.times[this.times.length - 1];
    if (this.clock > end) this.clock = this.times[0];
    this.show(frameAt(this.times, this.clock));
    requestAnimationFrame((then) => this.tick(then));
  }

  seek(frame) {
    const to = Math.min(this.times.length - 1, Math.max(0, frame));
    this.clock = this.times[to];
    this.show(to);
  }

  show(frame) {
    if (frame === this.frame && document.body.dataset.frame === String(frame)) return;
    this.frame = frame;
    this.draw();
  }

  draw() {
    const { gl, canvas, find, uniform, frame } = this, ratio = window.devicePixelRatio || 1;
    const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { matrix, toward, up } = viewMatrix(this.camera, width / Math.max(height, 1));
    gl.uniformMatrix4fv(uniform.view, false, matrix);
    const light = toward.map((v, i) => v + 0.5 * up[i]), norm = Math.hypot(...light);
    gl.uniform3fv(uniform.light, light.map((v) => v / norm));
    const chosen = this.data.colourings.find((each) => each.name === find("colour").value);
    gl.uniform1f(uniform.top, chosen ? Math.max(chosen.high, 1e-30) : 1);
    for (const mesh of this.meshes) mesh.draw(uniform, this.attribute, frame, chosen ? chosen.name : "");
    this.legend(chosen);
    find("frame").value = frame;
    find("time").textContent = "t = " + measured(this.times[frame], "s");
    for (const graph of this.graphs) graph.draw(this.times[frame]);
    document.body.dataset.frame = frame;
  }

  legend(chosen) {
    const { find } = this;
    find("legend").hidden = !chosen;
    if (!chosen) return;
    find("quantity").textContent = chosen.name.replaceAll("_", " ") + (chosen.unit ? " (" + chosen.unit + ")" : "");
    find("low").textContent = measured(chosen.low, chosen.unit);
    find("high").textContent = measured(chosen.high, chosen.unit);
    const pen = find("bar").getContext("2d");
    for (let i = 0; i < 160; i++) {
      pen.fillStyle = "rgb(" + viridis(i / 159).map((c) => Math.round(255 * c)).join(",") + ")";
      pen.fillRect(i, 0, 1, 10);
    }
  }
}

function start() {
  const trouble = (text) => {
    const place = document.getElementById("trouble");
    place.hidden = false;
    place.textContent = text;
  };
  try {
    const player = new Player(JSON.parse(document.getElementById("data").textContent));
    window.player = player;
    player.draw();
    if (!location.hash.includes("still")) player.toggle();
  } catch (problem) {
    trouble(problem.message);
    throw problem;
  }
}

if (typeof document === "undefined") module.exports = { bytesOf, decoded, frameAt, viridis, measured, ticks, viewMatrix };
else start();
