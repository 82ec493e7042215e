// Parts of the scene on the graphics card.

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
