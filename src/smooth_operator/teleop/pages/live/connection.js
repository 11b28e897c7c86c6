// Covers the scene with a red warning while the emergency stop does not reach the loop.
//
// A worker asks, since without a graphics card the page itself may be busy for seconds.
(() => {
  const LIMIT_MS = 500; // longest time without an answer
  const ask = (path, limit) => {
    let answered = performance.now(), lost = false;
    setInterval(async () => {
      try {
        const signal = AbortSignal.timeout(limit);
        const answer = await fetch(path, { cache: "no-store", signal });
        if (answer.status === 204) answered = performance.now();
      } catch {} // no answer
    }, 200);
    setInterval(() => {
      const now = performance.now() - answered > limit;
      if (now !== lost) postMessage((lost = now));
    }, 50);
  };
  const source = `(${ask})(${JSON.stringify(location.origin + "ALIVE_PATH")}, ${LIMIT_MS})`;
  const worker = new Worker(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));

  const warning = document.createElement("div");
  warning.id = "live-lost";
  warning.setAttribute("role", "alert");
  worker.onmessage = ({ data: lost }) => {
    document.documentElement.toggleAttribute("data-lost", lost);
    if (lost) {
      const elsewhere = document.querySelector("#live-elsewhere")?.textContent ?? "";
      warning.innerHTML = "<b>CONNECTION LOST</b><b>The stop button does not work.</b>";
      warning.append(elsewhere);
      document.body.append(warning);
    } else warning.remove();
  };
})();
