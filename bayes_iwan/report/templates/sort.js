"use strict";
// Tables of class "sortable": a click on a column's name sorts by it, a second one the other way round.
(function () {
  const value = (cell) => {
    const text = cell.textContent.replace(/\u2212/g, "-").trim(), number = parseFloat(text.replace(/^[<>≥≤~ ]+/, ""));
    return [Number.isNaN(number) ? -Infinity : number, text];
  };
  for (const table of document.querySelectorAll("table.sortable")) {
    const heads = Array.from(table.tHead.rows[0].cells);
    heads.forEach((head, i) => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = head.textContent;
      head.replaceChildren(button);
      button.addEventListener("click", () => {
        const down = head.getAttribute("aria-sort") === "ascending", sign = down ? -1 : 1;
        heads.forEach((h) => h.removeAttribute("aria-sort"));
        head.setAttribute("aria-sort", down ? "descending" : "ascending");
        const rows = Array.from(table.tBodies[0].rows), keys = new Map(rows.map((r) => [r, value(r.cells[i])]));
        rows.sort((p, q) => {
          const [a, s] = keys.get(p), [b, t] = keys.get(q);
          return sign * (a !== b && !Number.isNaN(a - b) ? a - b : s.localeCompare(t));
        });
        table.tBodies[0].append(...rows);
      });
    });
  }
})();
