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
// One part of the page, or one ranking, at a time; without a script all of them stand below each other.
function choose(inputs, shown, name) {
  const show = () => {
    const chosen = inputs.find((input) => input.checked);
    shown.forEach((one) => { one.hidden = one.dataset[name] !== chosen.value; });
  };
  inputs.forEach((input) => input.addEventListener("change", show));
  if (inputs.length) show();
}
const parts = [...document.querySelectorAll(".part")];
choose([...document.querySelectorAll("input[name=part]")], parts, "part");
for (const part of parts) {
  const inputs = [...part.querySelectorAll("nav input")];
  choose(inputs, [...part.querySelectorAll(".gallery")], "reward");
}
