// What pages have in common: tables can be sorted by their columns and saved as CSV, and a picture that moves can be stopped.

/** Return what a cell counts as in a sort: its first number, or else its text. A dash comes last. */
function worth(cell) {
  const text = cell?.innerText.trim() ?? "";
  const number = text.match(/^[^\p{L}]*?([-−+]?\d+(\.\d+)?)/u);
  if (text === "" || text === "–") return [2, ""];
  return number ? [0, Number(number[1].replace("−", "-"))] : [1, text.toLowerCase()];
}

function compare(a, b) {
  return a[0] - b[0] || (a[0] === 0 ? a[1] - b[1] : a[1].localeCompare(b[1]));
}

/** Sort each body of a table by a column. The row that names a group stays the first. */
function sort(table, head, column) {
  const down = head.getAttribute("aria-sort") === "ascending";
  for (const other of table.tHead.querySelectorAll("th")) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  for (const body of table.tBodies) {
    const rows = [...body.rows].filter((row) => !row.matches(".group"));
    const keys = new Map(rows.map((row) => [row, worth(row.cells[column])]));
    const last = (row) => (keys.get(row)[0] === 2 ? 1 : 0);
    rows.sort((a, b) => last(a) - last(b) || (down ? -1 : 1) * compare(keys.get(a), keys.get(b)));
    body.append(...rows);
  }
}

function csv(table) {
  const rows = [...table.rows].map((row) =>
    [...row.cells].map((cell) => `"${cell.innerText.trim().replace(/\s*\n\s*/g, "; ").replaceAll('"', '""')}"`).join(","),
  );
  return `${rows.join("\n")}\n`;
}

for (const table of document.querySelectorAll(".scroll > table")) {
  const head = table.tHead?.rows[0];
  const plain = !table.querySelector("[rowspan]") && [...table.rows].every((row) => row.matches(".group") || row.cells.length === head?.cells.length);
  if (head && plain && [...table.tBodies].some((body) => body.rows.length > 2)) {
    [...head.cells].forEach((cell, column) => {
      if (cell.querySelector("svg") || !cell.textContent.trim()) return;
      const button = document.createElement("button");
      button.append(...cell.childNodes);
      button.addEventListener("click", () => sort(table, cell, column));
      cell.append(button);
    });
  }
  const link = document.createElement("a");
  link.href = "#";
  link.textContent = "CSV";
  link.setAttribute("aria-label", `CSV of: ${table.parentElement.getAttribute("aria-label")}`);
  link.download = `${document.title.split(" – ")[0]} ${table.parentElement.getAttribute("aria-label")}.csv`;
  link.addEventListener("click", () => {
    link.href = `data:text/csv;charset=utf-8,${encodeURIComponent(csv(table))}`;
  });
  const line = document.createElement("p");
  line.className = "csv";
  line.append(link);
  table.parentElement.after(line);
}

for (const figure of document.querySelectorAll("figure.failed")) {
  const picture = figure.querySelector("svg");
  const button = document.createElement("button");
  button.textContent = "Pause";
  button.addEventListener("click", () => {
    const paused = picture.animationsPaused();
    if (paused) picture.unpauseAnimations();
    else picture.pauseAnimations();
    button.textContent = paused ? "Pause" : "Play";
  });
  figure.append(button);
}
