// Plays the landmarks embedded in the page: human in grey, robot in its method's colour, objects
// as lines.
(() => {
  "use strict";
  addEventListener("beforeprint", () => {
    for (const folded of document.querySelectorAll("details")) folded.open = true;
  });

  const ABSENT = -32768;

  const unpack = (text) => {
    const bytes = atob(text);
    const points = new Int16Array(bytes.length / 2);
    for (let i = 0; i < points.length; i++)
      points[i] = bytes.charCodeAt(2 * i) | (bytes.charCodeAt(2 * i + 1) << 8);
    return points;
  };

  for (const player of document.querySelectorAll(".player")) {
    const clip = JSON.parse(player.querySelector("script").textContent);
    const humans = clip.humans.map(unpack);
    const robots = clip.panes.map((pane) => unpack(pane.robot));
    const objects = clip.panes.map((pane) => pane.objects && unpack(pane.objects));
    const canvases = [...player.querySelectorAll("canvas")];
    const button = player.querySelector("button");
    const slider = player.querySelector("input");
    const speed = player.querySelector("select");
    const clock = player.querySelector("output");
    const last = clip.times.length - 1;
    const start = clip.times[0];
    let frame = 0, time = 0, playing = false, before = 0, yaw = -0.45, pitch = 0.12;

    const skeleton = (context, points, at, bones, size, style) => {
      const [cy, sy, cp, sp] = [Math.cos(yaw), Math.sin(yaw), Math.cos(pitch), Math.sin(pitch)];
      const scale = (0.47 * size) / clip.reach;
      const place = (i) => {
        const k = 3 * ((style.points || 21) * at + i);
        if (points[k] === ABSENT) return null;
        const x = cy * points[k] + sy * points[k + 2];
        const z = cy * points[k + 2] - sy * points[k];
        return [size / 2 + scale * x, size / 2 - scale * (cp * points[k + 1] - sp * z)];
      };
      context.lineWidth = style.width;
      for (const [parent, child] of bones) {
        const from = place(parent), to = place(child);
        if (!from || !to) continue;
        context.strokeStyle = context.fillStyle = style.color;
        context.beginPath();
        context.moveTo(...from);
        context.lineTo(...to);
        context.stroke();
        if (style.dot) {
          context.beginPath();
          context.arc(...to, child % 4 ? style.dot : 1.7 * style.dot, 0, 7);
          context.fill();
        }
      }
    };

    const draw = () => {
      canvases.forEach((canvas, i) => {
        const ratio = window.devicePixelRatio || 1;
        const size = canvas.clientWidth || 220;
        if (canvas.width !== Math.round(size * ratio))
          canvas.width = canvas.height = Math.round(size * ratio);
        const context = canvas.getContext("2d");
        context.setTransform(ratio, 0, 0, ratio, 0, 0);
        context.clearRect(0, 0, size, size);
        context.lineCap = "round";
        const ink = getComputedStyle(canvas).color;
        context.globalAlpha = 0.28;
        skeleton(context, humans[clip.panes[i].human], frame, clip.humanBones, size,
          { width: size / 42, color: ink });
        context.globalAlpha = 0.8;
        if (objects[i])
          skeleton(context, objects[i], frame, clip.objectEdges, size,
            { width: size / 190, color: ink, points: clip.objectPoints });
        context.globalAlpha = 1;
        skeleton(context, robots[i], frame, clip.robotBones, size,
          { width: size / 95, dot: size / 95, color: clip.panes[i].color });
      });
      slider.value = frame;
      clock.textContent = clip.times[frame].toFixed(2) + " s";
    };

    const seek = (to) => {
      frame = Math.min(Math.max(to, 0), last);
      time = clip.times[frame] - start;
      draw();
    };
    const tick = (now) => {
      if (!playing) return;
      time += ((now - before) / 1000) * Number(speed.value);
      before = now;
      if (time > clip.times[last] - start) { time = 0; frame = 0; }
      while (frame < last && clip.times[frame + 1] - start <= time) frame++;
      draw();
      requestAnimationFrame(tick);
    };
    const play = (on) => {
      playing = on;
      button.textContent = on ? "Pause" : "Play";
      if (on) { before = performance.now(); requestAnimationFrame(tick); }
    };

    button.addEventListener("click", () => play(!playing));
    slider.max = last;
    slider.addEventListener("input", () => { play(false); seek(Number(slider.value)); });
    for (const canvas of canvases) {
      canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
      canvas.addEventListener("pointermove", (event) => {
        if (!event.buttons) return;
        yaw += event.movementX / 110;
        pitch = Math.min(Math.max(pitch + event.movementY / 110, -1.5), 1.5);
        draw();
      });
      canvas.addEventListener("dblclick", () => { yaw = -0.45; pitch = 0.12; draw(); });
    }
    new ResizeObserver(draw).observe(player);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    seek(Math.floor(last / 3));
  }
})();
