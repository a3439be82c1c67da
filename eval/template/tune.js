// Both collision shapes, drawn ball by ball into a depth buffer: exact unions, without a graphics card.
const content = JSON.parse(document.getElementById("content").textContent);
const floats = text => new Float32Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
const shapes = { full: floats(content.full), lean: floats(content.lean) };

// What was seen, as cells as wide as the guard: a point is coloured by a sample in its cell or one beside it.
const cell = Math.max(content.guard_m / 2, 1e-4), seen = new Set();
const number = (x, y, z) => (x + 1e5) * 4e10 + (y + 1e5) * 2e5 + (z + 1e5);
const samples = floats(content.seen);
for (let i = 0; i < samples.length; i += 3) {
  const at = [0, 1, 2].map(k => Math.floor(samples[i + k] / cell));
  for (let a = -1; a < 2; a++) for (let b = -1; b < 2; b++) for (let c = -1; c < 2; c++) seen.add(number(at[0] + a, at[1] + b, at[2] + c));
}
const isSeen = (x, y, z) => seen.has(number(Math.floor(x / cell), Math.floor(y / cell), Math.floor(z / cell)));

const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
for (let i = 0; i < shapes.full.length; i += 4)
  for (let k = 0; k < 3; k++) {
    low[k] = Math.min(low[k], shapes.full[i + k] - shapes.full[i + 3]);
    high[k] = Math.max(high[k], shapes.full[i + k] + shapes.full[i + 3]);
  }
const middle = low.map((value, k) => (value + high[k]) / 2);
const size = Math.hypot(...high.map((value, k) => value - low[k])) / 2 || 1;

// Rows: right, up, towards the eye. The first view is one from which much of what was seen is in sight.
let turn = (() => {
  const towards = [0, 0, 0];
  for (let i = 0; i < samples.length; i += 3) for (let k = 0; k < 3; k++) towards[k] += samples[i + k] - middle[k];
  const length = Math.hypot(...towards);
  let eye = length > 1e-9 ? towards.map(v => v / length) : [1, 0, 0];
  eye = eye.map((v, k) => v + [0.35, -0.5, 0.45][k]);
  const n = Math.hypot(...eye);
  eye = eye.map(v => v / n);
  let right = [-eye[1], eye[0], 0];
  const r = Math.hypot(...right);
  right = r > 1e-6 ? right.map(v => v / r) : [1, 0, 0];
  return [right, cross(eye, right), eye];
})();
let zoom = 1;
function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }

function colours() {
  const style = getComputedStyle(document.documentElement);
  return ["--seen", "--rest"].map(name => {
    const hex = style.getPropertyValue(name).trim();
    return [1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16));
  });
}

function draw(canvas, balls, pixels) {
  const width = Math.round(pixels), height = Math.round(pixels * 3 / 4);
  canvas.width = width;
  canvas.height = height;
  const context = canvas.getContext("2d"), image = context.createImageData(width, height), out = image.data;
  const depth = new Float32Array(width * height).fill(-1e9), scale = zoom * height / (2.05 * size);
  const [warm, grey] = colours();
  const [right, up, eye] = turn, light = [-0.35, 0.5, 0.8].map(v => v / Math.hypot(0.35, 0.5, 0.8));
  for (let i = 0; i < balls.length; i += 4) {
    const x = balls[i] - middle[0], y = balls[i + 1] - middle[1], z = balls[i + 2] - middle[2], radius = balls[i + 3];
    const u = width / 2 + scale * (x * right[0] + y * right[1] + z * right[2]);
    const v = height / 2 - scale * (x * up[0] + y * up[1] + z * up[2]);
    const w = x * eye[0] + y * eye[1] + z * eye[2], r = scale * radius;
    const first = Math.max(0, Math.ceil(v - r)), last = Math.min(height - 1, Math.floor(v + r));
    for (let row = first; row <= last; row++) {
      const dv = (v - row) / scale, half = Math.sqrt(Math.max(0, radius * radius - dv * dv)) * scale;
      const begin = Math.max(0, Math.ceil(u - half)), end = Math.min(width - 1, Math.floor(u + half));
      for (let column = begin; column <= end; column++) {
        const du = (column - u) / scale, dw = Math.sqrt(Math.max(0, radius * radius - du * du - dv * dv));
        const at = row * width + column;
        if (w + dw <= depth[at]) continue;
        depth[at] = w + dw;
        const px = balls[i] + du * right[0] + dv * up[0] + dw * eye[0];
        const py = balls[i + 1] + du * right[1] + dv * up[1] + dw * eye[1];
        const pz = balls[i + 2] + du * right[2] + dv * up[2] + dw * eye[2];
        const shade = 0.5 + 0.5 * Math.max(0, (du * light[0] + dv * light[1] + dw * light[2]) / radius);
        const colour = isSeen(px, py, pz) ? warm : grey;
        for (let k = 0; k < 3; k++) out[4 * at + k] = colour[k] * shade;
        out[4 * at + 3] = 255;
      }
    }
  }
  context.putImageData(image, 0, 0);
}

const canvases = Object.keys(shapes).map(name => document.getElementById(name));
let waiting = 0, dragging = false;
function redraw() {
  cancelAnimationFrame(waiting);
  waiting = requestAnimationFrame(() => {
    for (const canvas of canvases) {
      const full = canvas.clientWidth * Math.min(devicePixelRatio, 2);
      draw(canvas, shapes[canvas.id], dragging ? Math.min(full, 420) : full);
    }
  });
}
function rotate(a, b, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), first = turn[a].slice();
  turn[a] = first.map((v, k) => c * v + s * turn[b][k]);
  turn[b] = turn[b].map((v, k) => c * v - s * first[k]);
}
for (const canvas of canvases) {
  canvas.addEventListener("pointerdown", event => { dragging = true; canvas.setPointerCapture(event.pointerId); });
  canvas.addEventListener("pointermove", event => {
    if (!dragging) return;
    rotate(0, 2, -event.movementX / 140);
    rotate(1, 2, event.movementY / 140);
    redraw();
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { dragging = false; redraw(); });
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    zoom = Math.min(12, Math.max(0.5, zoom * Math.exp(-event.deltaY / 500)));
    redraw();
  }, { passive: false });
}
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
redraw();
