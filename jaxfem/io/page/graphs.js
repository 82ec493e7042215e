// Graphs beside the picture, in step with it.

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
    for (const value of ticks(first, last, 4)) {
      const text = measured(value, "s"), half = pen.measureText(text).width / 2;
      pen.fillText(text, Math.min(x(value), canvas.clientWidth - half - 1), box.bottom + 14);
    }
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
