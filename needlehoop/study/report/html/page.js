"use strict";
// A click on a heading sorts a table: numbers by value, texts by letters, empty cells last.
for (const table of document.querySelectorAll("table")) {
  [...table.tHead.rows[0].cells].forEach((head, column) => head.addEventListener("click", () => {
    const sign = head.dataset.sorted === "1" ? -1 : 1;
    head.dataset.sorted = sign;
    const text = (row) => row.cells[column].textContent;
    const rows = [...table.tBodies[0].rows].sort((a, b) => {
      const x = text(a), y = text(b);
      if (!x || !y) return !x - !y;
      return sign * (parseFloat(x) - parseFloat(y) || x.localeCompare(y));
    });
    table.tBodies[0].append(...rows);
  }));
}
