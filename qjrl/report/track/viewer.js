// Plays the arm along its path on a canvas: drag or arrow keys turn, the slider seeks, the button plays and pauses.
(function () {
  "use strict";
  const root = document.currentScript.parentElement;
  const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
  const canvas = root.querySelector("canvas"), context = canvas.getContext("2d");
  const button = root.querySelector("button"), slider = root.querySelector("input");
  const speed = root.querySelector("select"), clock = root.querySelector("output");
  const arm = decode(data.arm), path = decode(data.path), count = data.time.length;
  const first = data.time[0], last = data.time[count - 1];
  const LINKS = ["#3f5f7f", "#6f94b8"], PAUSE = 0.8;
  const state = { azimuth: -1.0, elevation: 0.35, zoom: 1.0, time: first, isPlaying: true };

  function decode(text) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return Float32Array.from(new Int16Array(bytes.buffer), (value) => value * data.unit);
  }

  function colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim() || "#888888";
  }

  function reach() {
    let largest = 0.1;
    for (let i = 0; i < arm.length; i += 3) largest = Math.max(largest, Math.hypot(arm[i], arm[i + 1], arm[i + 2]));
    return largest;
  }
  const extent = reach();

  function frameAt(time) {
    let low = 0, high = count - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (data.time[middle] <= time) low = middle;
      else high = middle;
    }
    return Math.abs(data.time[high] - time) < Math.abs(data.time[low] - time) ? high : low;
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = (canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio)));
    const height = (canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio)));
    const ca = Math.cos(state.azimuth), sa = Math.sin(state.azimuth);
    const ce = Math.cos(state.elevation), se = Math.sin(state.elevation);
    const scale = (0.85 * Math.min(width, height) * state.zoom) / extent;
    const place = (x, y, z) => [
      width / 2 + scale * (-sa * x + ca * y),
      height / 2 - scale * (-se * ca * x - se * sa * y + ce * (z - extent / 2)),
    ];
    const line = (points, tone, thickness) => {
      context.strokeStyle = tone;
      context.lineWidth = thickness;
      context.lineCap = context.lineJoin = "round";
      context.beginPath();
      points.forEach((point, index) => (index ? context.lineTo(...point) : context.moveTo(...point)));
      context.stroke();
    };
    const ring = (radius, tone) => {
      const points = [];
      for (let i = 0; i <= 60; i++) points.push(place(radius * Math.cos(i * Math.PI / 30), radius * Math.sin(i * Math.PI / 30), 0));
      line(points, tone, ratio);
    };
    [0.1, 0.2, 0.3].forEach((radius) => ring(radius, colour("rule")));

    const shown = frameAt(state.time), stride = 3 * data.points;
    const point = (frame, index) => place(...arm.subarray(frame * stride + 3 * index, frame * stride + 3 * index + 3));
    for (let i = 1; i < data.points; i++) {
      const isLink = i % 2 === 0; // even points are ends of links, odd ones upper plates of joints
      const tone = isLink ? LINKS[data.segments[i - 1] % 2] : "#c79a3e";
      line([point(shown, i - 1), point(shown, i)], tone, (isLink ? 1.7 : 0.7) * data.radius * scale);
    }
    const wanted = [];
    for (let i = 0; i < path.length; i += 3) wanted.push(place(path[i], path[i + 1], path[i + 2]));
    line(wanted, colour("reference"), 1.2 * ratio);
    const trail = [];
    for (let frame = 0; frame <= shown; frame++) trail.push(point(frame, data.points - 1));
    line(trail, colour("orange"), 2.4 * ratio);
    const tip = trail[trail.length - 1];
    context.fillStyle = colour("orange");
    context.beginPath();
    context.arc(tip[0], tip[1], 5 * ratio, 0, 2 * Math.PI);
    context.fill();
    clock.textContent = Math.max(0, state.time).toFixed(2) + " s";
    slider.value = String(Math.round((1000 * (state.time - first)) / (last - first)));
  }

  let before = null;
  function tick(now) {
    if (before !== null && state.isPlaying) {
      state.time += (Number(speed.value) * (now - before)) / 1000;
      if (state.time > last + PAUSE * Number(speed.value)) state.time = first;
      draw();
    }
    before = now;
    requestAnimationFrame(tick);
  }

  function turn(across, up) {
    state.azimuth -= across;
    state.elevation = Math.max(-1.57, Math.min(1.57, state.elevation + up));
    draw();
  }

  button.addEventListener("click", () => {
    state.isPlaying = !state.isPlaying;
    button.textContent = state.isPlaying ? "Pause" : "Play";
  });
  slider.addEventListener("input", () => {
    state.time = first + ((last - first) * Number(slider.value)) / 1000;
    if (state.isPlaying) button.click();
    draw();
  });
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) turn(0.008 * event.movementX, 0.008 * event.movementY);
  });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.08, 0], ArrowRight: [0.08, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] };
    const factor = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[event.key];
    if (event.key in steps) turn(...steps[event.key]);
    else if (factor) state.zoom = Math.max(0.4, Math.min(8, state.zoom * factor));
    else return;
    event.preventDefault();
    draw();
  });
  window.addEventListener("resize", draw);
  if (window.matchMedia("(prefers-reduced-motion: reduce)").matches) button.click();
  draw();
  requestAnimationFrame(tick);
})();
