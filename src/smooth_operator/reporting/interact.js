// Tables sort by their columns; hovering a method shows its series in the plots and dims the others.
(() => {
  "use strict";

  const merit = (value, goal) =>
    goal === "->1" ? -Math.abs(value - 1) : goal === "down" ? -value : value;

  for (const table of document.querySelectorAll("table.sortable")) {
    const body = table.tBodies[0];
    const first = [...body.rows];
    const heads = [...table.tHead.rows[table.tHead.rows.length - 1].cells];  // below the groups
    let by = null;
    const sort = (head) => {
      const column = head.cellIndex;
      const order = by === head ? { descending: "ascending", ascending: "none" }[head.ariaSort] : "descending";
      for (const one of heads) one.ariaSort = "none";
      head.ariaSort = order ?? "descending";
      by = head.ariaSort === "none" ? null : head;
      const worth = (row) => {
        const value = row.cells[column]?.dataset.value;
        return value === undefined ? -Infinity : merit(Number(value), head.dataset.goal);
      };
      const sign = head.ariaSort === "ascending" ? -1 : 1;
      const rows = by === null ? first : [...first].sort((a, b) => {
        const [x, y] = [worth(a), worth(b)];
        if (x === y) return 0;
        if (x === -Infinity) return 1;  // without a value: last in either order
        if (y === -Infinity) return -1;
        return sign * (y - x);
      });
      body.append(...rows);
    };
    for (const head of heads) {
      if (!head.dataset.goal) continue;
      head.tabIndex = 0;
      head.ariaSort = "none";
      head.title = "Sort: best first, worst first, as it was";
      head.addEventListener("click", () => sort(head));
      head.addEventListener("keydown", (event) => {
        if (event.key !== "Enter" && event.key !== " ") return;
        event.preventDefault();
        sort(head);
      });
    }
  }

  const all = [...document.querySelectorAll("svg .series")];
  const focus = (name) => {
    for (const one of all) one.classList.toggle("dim", name !== null && one.dataset.series !== name);
  };
  for (const one of document.querySelectorAll("[data-series]")) {
    const area = one.tagName === "TH" && one.scope === "row" ? one.closest("tr") : one;
    area.addEventListener("pointerenter", () => focus(one.dataset.series));
    area.addEventListener("pointerleave", () => focus(null));
  }
})();
