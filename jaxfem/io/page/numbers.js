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

if (typeof document === "undefined") module.exports = { bytesOf, decoded, frameAt, viridis, measured, ticks, viewMatrix };
