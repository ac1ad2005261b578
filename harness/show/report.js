"use strict";
document.documentElement.classList.add("scripted");

const tip = document.getElementById("tip");
let told = null;

function meaning(button) {
  const names = button.closest(".table")?.querySelectorAll("dt") ?? [];
  for (const name of names) if (name.textContent === button.textContent) return name.nextElementSibling.textContent;
  return "";
}

function tell(target) {
  const at = target.closest?.("[data-tip], thead th button");
  if (at === told) return;
  told?.removeAttribute("aria-describedby");
  told = at;
  const text = at && (at.dataset.tip || meaning(at));
  tip.hidden = !text;
  if (!text) return;
  tip.textContent = text;
  at.setAttribute("aria-describedby", "tip");
  const box = at.getBoundingClientRect();
  const below = box.bottom + 6 + tip.offsetHeight <= innerHeight;
  tip.style.left = `${Math.max(4, Math.min(box.left, innerWidth - tip.offsetWidth - 4))}px`;
  tip.style.top = `${below ? box.bottom + 6 : Math.max(4, box.top - 6 - tip.offsetHeight)}px`;
}

document.addEventListener("pointerover", (event) => tell(event.target));
document.addEventListener("focusin", (event) => tell(event.target));
document.addEventListener("scroll", () => tell(document.body), { capture: true, passive: true });
document.addEventListener("keydown", (event) => event.key === "Escape" && tell(document.body));

for (const map of document.querySelectorAll(".heat")) {
  const first = map.querySelector("td[data-tip]");
  if (first) first.tabIndex = 0;
  map.addEventListener("keydown", (event) => {
    const [down, right] =
      { ArrowDown: [1, 0], ArrowUp: [-1, 0], ArrowRight: [0, 1], ArrowLeft: [0, -1] }[event.key] ?? [0, 0];
    const cell = event.target.closest("td[data-tip]");
    if (!cell || !(down || right)) return;
    event.preventDefault();
    let row = cell.parentElement.rowIndex;
    let column = cell.cellIndex;
    for (;;) {
      const next = map.rows[(row += down)]?.cells[(column += right)];
      if (!next || next.tagName === "TH") return;
      if (!next.dataset.tip) continue;
      cell.tabIndex = -1;
      next.tabIndex = 0;
      next.focus();
      return;
    }
  });
}

function value(cell) {
  return cell.dataset.v === undefined ? NaN : Number(cell.dataset.v);
}

function sort(button) {
  const head = button.closest("th");
  const body = head.closest("table").tBodies[0];
  const column = head.cellIndex;
  const numeric = head.classList.contains("n");
  const before = head.getAttribute("aria-sort");
  const up = before ? before === "descending" : !numeric;
  const way = up ? 1 : -1;
  for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const rows = [...body.rows].map((row) => [row, row.cells[column]]);
  const texts = new Intl.Collator("en", { numeric: true });
  rows.sort(([, a], [, b]) => {
    if (!numeric) return way * texts.compare(a.textContent, b.textContent);
    const [x, y] = [value(a), value(b)];
    return Number.isNaN(x) || Number.isNaN(y) ? Number.isNaN(x) - Number.isNaN(y) : way * (x - y);
  });
  body.append(...rows.map(([row]) => row));
}

function headings(table) {
  return [...table.tHead.rows[0].cells].map((cell) => cell.textContent);
}

const board = document.getElementById("lines");
const filters = [...document.querySelectorAll("select[data-column]")];

function filter() {
  const table = board.querySelector("table");
  const names = headings(table);
  const asked = filters.filter((one) => one.value).map((one) => [names.indexOf(one.dataset.column), one.value]);
  let shown = 0;
  for (const row of table.tBodies[0].rows) {
    row.hidden = asked.some(([column, text]) => row.cells[column].textContent !== text);
    shown += !row.hidden;
  }
  board.querySelector("[role=status]").textContent = `${shown} of ${table.tBodies[0].rows.length} lines`;
}

if (board) {
  for (const one of filters) one.addEventListener("change", filter);
  filter();
}

document.getElementById("more")?.addEventListener("click", (event) => {
  const all = board.classList.toggle("all");
  event.target.setAttribute("aria-pressed", all);
});

function csv(table) {
  const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  // A spreadsheet would compute a text that begins like this (harness/show/spreadsheet.py).
  const plain = (text) => (/^'*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]/.test(text) ? `'${text}` : text);
  const rows = [...table.tBodies[0].rows].filter((row) => !row.hidden);
  const bounded = headings(table).map((_, i) => rows.some((row) => row.cells[i].dataset.b));
  const head = headings(table).flatMap((name, i) => {
    const plain = name.replace(" [95 %]", "");
    return bounded[i] ? [plain, `${plain} low`, `${plain} high`] : [plain];
  });
  const lines = rows.map((row) =>
    [...row.cells].flatMap((cell, i) => {
      const text = cell.dataset.v ?? (table.tHead.rows[0].cells[i].className === "n" ? "" : plain(cell.textContent));
      return bounded[i] ? [text, ...(cell.dataset.b ?? " ").split(" ")] : [text];
    }),
  );
  return [head, ...lines].map((line) => line.map(quoted).join(",") + "\n").join("");
}

function tex(table) {
  const special = { "\\": "\\textbackslash{}", "~": "\\textasciitilde{}", "^": "\\textasciicircum{}" };
  const safe = (text) =>
    text.replace(/[\\~^&%$#_{}]/g, (c) => special[c] ?? `\\${c}`).replaceAll("π", "$\\pi$").replaceAll("\u2212", "$-$");
  const visible = (cell) => getComputedStyle(cell).display !== "none";
  const line = (row) => [...row.cells].filter(visible).map((cell) => safe(cell.textContent)).join(" & ") + " \\\\\n";
  const head = table.tHead.rows[0];
  const columns = [...head.cells].filter(visible).map((cell) => (cell.className === "n" ? "r" : "l")).join("");
  const rows = [...table.tBodies[0].rows].filter((row) => !row.hidden);
  return (
    `% \\usepackage{booktabs}\n\\begin{tabular}{${columns}}\n\\toprule\n${line(head)}\\midrule\n` +
    `${rows.map(line).join("")}\\bottomrule\n\\end{tabular}\n`
  );
}

function save(name, content) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content);
  link.download = name.replace(/[^\w.]+/g, "_");
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

async function unpack(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).blob();
}

document.addEventListener("click", async (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  const within = button.closest(".table");
  if (button.dataset.file) {
    const files = JSON.parse(document.getElementById("files").textContent);
    save(`${button.dataset.file}.csv`, await unpack(files[button.dataset.file]));
  } else if (button.dataset.save) {
    const text = { csv, tex }[button.dataset.save](within.querySelector("table"));
    save(`${within.dataset.name}.${button.dataset.save}`, new Blob([text], { type: "text/plain" }));
  } else if (within && button.closest("thead")) sort(button);
});

addEventListener("beforeprint", () => {
  for (const one of document.querySelectorAll(".fold")) one.open = true;
});
