// Tables that would be cut off are set tighter; where that does not do, and on a phone, rows become lists (site.css).
document.addEventListener("DOMContentLoaded", () => {
  const phone = window.matchMedia("(max-width: 44.9em)").matches;
  for (const table of document.querySelectorAll(".md-typeset table:not([class])")) {
    const names = [...table.querySelectorAll("thead th")].map((cell) => cell.textContent.trim());
    const room = table.closest("article").clientWidth;
    const wide = () => table.getBoundingClientRect().width > room;
    if (!names.length || (!wide() && !phone)) continue;
    table.className = "tight";
    if (!wide() && !(phone && names.length > 1)) continue;
    table.className = "tight listed";
    for (const row of table.tBodies[0].rows) {
      [...row.cells].forEach((cell, k) => cell.setAttribute("data-name", names.length > 2 ? `${names[k]}: ` : ""));
    }
  }
});
