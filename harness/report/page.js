"use strict";
document.documentElement.classList.add("scripted");

const tip = document.getElementById("tip");
let described = null;

function tell(target) {
  const at = target.closest?.("[data-tip], th[data-column] button");
  if (at === described) return;
  described?.removeAttribute("aria-describedby");
  described = at;
  const column = at?.parentElement.dataset.column;
  const text = column ? document.getElementById(`column-${column}`).textContent : at?.dataset.tip;
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
const scrolled = () => {
  const at = described;
  tell(document.body);
  if (at && at === document.activeElement) tell(at);
};
document.addEventListener("scroll", scrolled, { capture: true, passive: true });
document.addEventListener("keydown", (event) => event.key === "Escape" && tell(document.body));

function sort(button) {
  const head = button.closest("th");
  const body = head.closest("table").tBodies[0];
  const numeric = head.classList.contains("n");
  const before = head.getAttribute("aria-sort");
  const up = before ? before === "descending" : !numeric;
  const way = up ? 1 : -1;
  for (const other of head.parentElement.cells) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", up ? "ascending" : "descending");
  const rows = [...body.rows].map((row) => [row, row.cells[head.cellIndex]]);
  const texts = new Intl.Collator("en", { numeric: true });
  rows.sort(([, a], [, b]) => {
    if (!numeric) return way * texts.compare(a.textContent, b.textContent);
    const [x, y] = [Number(a.dataset.v ?? NaN), Number(b.dataset.v ?? NaN)];
    return Number.isNaN(x) || Number.isNaN(y) ? Number.isNaN(x) - Number.isNaN(y) : way * (x - y);
  });
  body.append(...rows.map(([row]) => row));
}

const board = document.getElementById("lines");
const filters = [...document.querySelectorAll("select[data-filter]")];

function filter() {
  const table = board.querySelector("table");
  const place = (key) => table.tHead.querySelector(`[data-column="${key}"]`).cellIndex;
  const asked = filters.filter((one) => one.value).map((one) => [place(one.dataset.filter), one.value]);
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

for (const one of document.querySelectorAll(".switch input")) {
  const show = () => {
    for (const plot of one.closest("section").querySelectorAll("[data-choice]"))
      plot.hidden = plot.dataset.choice !== one.value;
  };
  one.addEventListener("change", show);
  if (one.checked) show();
}

document.getElementById("more")?.addEventListener("click", (event) => {
  event.target.setAttribute("aria-pressed", board.classList.toggle("all"));
});

const visible = (table) => [...table.tBodies[0].rows].filter((row) => !row.hidden);

function csv(table) {
  const quoted = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  // A spreadsheet would compute a text that begins like this (tables.py).
  const plain = (text) => (/^'*[=+\-@\t\r\n\uff1d\uff0b\uff0d\uff20]/.test(text) ? `'${text}` : text);
  const rows = visible(table);
  const heads = [...table.tHead.rows[0].cells];
  const bounded = heads.map((_, i) => rows.some((row) => row.cells[i].dataset.b));
  const head = heads.flatMap((cell, i) => {
    const title = cell.firstElementChild.dataset.title;
    return bounded[i] ? [title, `${title} low`, `${title} high`] : [title];
  });
  const lines = rows.map((row) =>
    [...row.cells].flatMap((cell, i) => {
      const text = cell.dataset.v ?? (heads[i].classList.contains("n") ? "" : plain(cell.textContent));
      return bounded[i] ? [text, ...(cell.dataset.b ?? " ").split(" ")] : [text];
    }),
  );
  return [head, ...lines].map((line) => line.map(quoted).join(",") + "\n").join("");
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
  const within = button?.closest(".table");
  if (button?.dataset.file) {
    const files = JSON.parse(document.getElementById("files").textContent);
    save(`${button.dataset.file}.csv`, await unpack(files[button.dataset.file]));
  } else if (button?.dataset.save) {
    save(`${within.dataset.name}.csv`, new Blob([csv(within.querySelector("table"))], { type: "text/plain" }));
  } else if (within && button.closest("thead")) sort(button);
});

addEventListener("beforeprint", () => {
  for (const one of document.querySelectorAll(".fold")) one.open = true;
});
