// What plays, and what is pressed, turned and chosen.

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

start();
