"use strict";
// Numbers by value, everything else by letters; empty cells last, whichever way.
function compare(a, b) {
  const x = parseFloat(a), y = parseFloat(b);
  if (!isNaN(x) && !isNaN(y)) return x - y;
  return a.localeCompare(b);
}
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => head.firstElementChild.addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const text = (row) => row.cells[column].textContent.trim();
    const rows = [...body.rows];
    rows.sort((a, b) => {
      const x = text(a), y = text(b);
      if (!x || !y) return (x ? 0 : 1) - (y ? 0 : 1);
      return down ? compare(y, x) : compare(x, y);
    });
    body.append(...rows);
  }));
}
