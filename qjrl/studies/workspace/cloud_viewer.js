// Turns clouds of points with the mouse, a finger or the arrow keys; a depth buffer on a canvas, nothing else.
(function () {
  "use strict";
  const root = document.currentScript.parentElement;
  const data = JSON.parse(root.querySelector("script[type='application/json']").textContent);
  const canvas = root.querySelector("canvas"), context = canvas.getContext("2d");
  const state = { azimuth: -1.0, elevation: 0.35, zoom: 1.0, isShown: data.clouds.map(() => true) };
  const clouds = data.clouds.map((cloud) => {
    const bytes = Uint8Array.from(atob(cloud.points), (letter) => letter.charCodeAt(0));
    return new Int16Array(bytes.buffer);
  });

  function colour(name) {
    const text = getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim() || "#888888";
    return [1, 3, 5].map((at) => parseInt(text.slice(at, at + 2), 16));
  }

  function projection() {
    const ca = Math.cos(state.azimuth), sa = Math.sin(state.azimuth);
    const ce = Math.cos(state.elevation), se = Math.sin(state.elevation);
    return { right: [-sa, ca, 0], up: [-se * ca, -se * sa, ce], eye: [ce * ca, ce * sa, se] };
  }

  function draw() {
    const ratio = window.devicePixelRatio || 1;
    const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    canvas.width = width;
    canvas.height = height;
    const image = context.createImageData(width, height), depth = new Float32Array(width * height).fill(-Infinity);
    const view = projection(), size = Math.max(1, Math.round(2 * ratio));
    const scale = (0.46 * Math.min(width, height) * state.zoom) / data.extent;
    const paper = colour("paper");
    clouds.forEach((points, index) => {
      if (!state.isShown[index]) return;
      const ink = colour(data.clouds[index].colour);
      for (let i = 0; i < points.length; i += 3) {
        const x = points[i], y = points[i + 1], z = points[i + 2] - data.middle;
        const along = x * view.eye[0] + y * view.eye[1] + z * view.eye[2];
        const column = Math.round(width / 2 + scale * (x * view.right[0] + y * view.right[1]));
        const row = Math.round(height / 2 - scale * (x * view.up[0] + y * view.up[1] + z * view.up[2]));
        const near = 0.55 + 0.45 * Math.max(0, Math.min(1, 0.5 + (0.5 * along) / data.extent));
        for (let r = row; r < row + size; r++) {
          for (let c = column; c < column + size; c++) {
            const at = r * width + c;
            if (r < 0 || c < 0 || r >= height || c >= width || depth[at] > along) continue;
            depth[at] = along;
            for (let part = 0; part < 3; part++) {
              image.data[4 * at + part] = near * ink[part] + (1 - near) * paper[part];
            }
            image.data[4 * at + 3] = 255;
          }
        }
      }
    });
    context.putImageData(image, 0, 0);
    drawAxes(view, scale, width, height, ratio);
  }

  function drawAxes(view, scale, width, height, ratio) {
    context.lineWidth = 1.5 * ratio;
    context.font = 12 * ratio + "px system-ui, sans-serif";
    [["x", "orange"], ["y", "teal"], ["z", "blue"]].forEach(([name, tone], axis) => {
      const place = (length) => {
        const point = [0, 0, -data.middle];
        point[axis] += length;
        return [
          width / 2 + scale * (point[0] * view.right[0] + point[1] * view.right[1]),
          height / 2 - scale * (point[0] * view.up[0] + point[1] * view.up[1] + point[2] * view.up[2]),
        ];
      };
      const start = place(0), end = place(data.axis), rgb = colour(tone);
      context.strokeStyle = context.fillStyle = "rgb(" + rgb.join(",") + ")";
      context.beginPath();
      context.moveTo(...start);
      context.lineTo(...end);
      context.stroke();
      context.fillText(name, end[0] + 4 * ratio, end[1] - 4 * ratio);
    });
  }

  function turn(across, up) {
    state.azimuth -= across;
    state.elevation = Math.max(-1.57, Math.min(1.57, state.elevation + up));
    schedule();
  }

  let isWaiting = false;
  function schedule() {
    if (isWaiting) return;
    isWaiting = true;
    requestAnimationFrame(() => {
      isWaiting = false;
      draw();
    });
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (canvas.hasPointerCapture(event.pointerId)) turn(0.008 * event.movementX, 0.008 * event.movementY);
  });
  canvas.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== canvas) return; // scrolling past must not zoom
    event.preventDefault();
    state.zoom = Math.max(0.4, Math.min(8, state.zoom * Math.exp(-0.0015 * event.deltaY)));
    schedule();
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const steps = { ArrowLeft: [-0.08, 0], ArrowRight: [0.08, 0], ArrowUp: [0, -0.08], ArrowDown: [0, 0.08] };
    const factor = { "+": 1.15, "=": 1.15, "-": 1 / 1.15 }[event.key];
    if (event.key in steps) turn(...steps[event.key]);
    else if (factor) state.zoom = Math.max(0.4, Math.min(8, state.zoom * factor));
    else return;
    event.preventDefault();
    schedule();
  });
  root.querySelectorAll("input").forEach((box, index) => {
    box.addEventListener("change", () => {
      state.isShown[index] = box.checked;
      schedule();
    });
  });
  window.addEventListener("resize", schedule);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", schedule);
  draw();
})();
