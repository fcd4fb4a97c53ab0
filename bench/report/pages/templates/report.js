"use strict";
// Tables that sort, figures that are drawn when they come into view, pictures with a border to move, runs side by side.

const dark = matchMedia("(prefers-color-scheme: dark)");

function keyOf(cell) {
  const text = cell.textContent.trim();
  if (text === "-" || text === "") return null;
  const number = /^[+-]?(\d[\d,]*\.?\d*|\.\d+)(e[+-]?\d+)?(?![\w.])/i.exec(text);
  return number ? Number(number[0].replaceAll(",", "")) : text.toLowerCase();
}

function compare(one, other) {
  if (typeof one === typeof other) return one < other ? -1 : one > other ? 1 : 0;
  return typeof one === "number" ? -1 : 1;
}

function sortBy(table, column, sign) {
  for (const body of table.tBodies) {
    const rows = [...body.rows].map((row) => [keyOf(row.cells[column]), row]);
    // What is not known stays last in both directions.
    rows.sort(([a], [b]) => (a === null || b === null ? (a === null) - (b === null) : sign * compare(a, b)));
    body.append(...rows.map(([, row]) => row));
  }
}

for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    head.querySelector("button").addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((each) => each.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      sortBy(table, column, up ? 1 : -1);
    });
  });
}

function colours(figure) {
  const style = getComputedStyle(document.documentElement);
  const text = style.getPropertyValue("--text").trim();
  const line = style.getPropertyValue("--line").trim();
  const layout = figure.layout;
  Object.assign(layout, { paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: text, size: 12 } });
  layout.hoverlabel = { bgcolor: style.getPropertyValue("--card").trim(), font: { color: text } };
  for (const axis of ["xaxis", "yaxis"]) {
    Object.assign(layout[axis], { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true });
  }
  return figure;
}

function draw(place) {
  const figure = colours(JSON.parse(place.figure));
  if (place.clientWidth < 600) {
    // Beside a narrow figure there is no room for a legend.
    figure.layout.legend = { orientation: "h", y: -0.25, yanchor: "top", x: 0, font: { size: 10 } };
    figure.layout.height = Math.max(figure.layout.height, place.clientWidth);
  }
  Plotly.react(place, figure.data, figure.layout, { displaylogo: false, responsive: true });
  place.drawn = true;
}

const seen = new IntersectionObserver(
  (entries) => {
    for (const entry of entries) {
      if (entry.isIntersecting && !entry.target.drawn) draw(entry.target);
    }
  },
  { rootMargin: "300px" },
);

for (const place of document.querySelectorAll(".plot")) {
  const own = place.querySelector("script");
  const choice = place.closest(".choice");
  const figures = choice ? [...choice.querySelectorAll(":scope > script")] : [own];
  place.figure = figures[0].textContent;
  place.replaceChildren();
  choice?.querySelector("select")?.addEventListener("change", (event) => {
    place.figure = figures[event.target.selectedIndex].textContent;
    place.setAttribute("aria-label", event.target.selectedOptions[0].textContent);
    draw(place);
  });
  seen.observe(place);
}
dark.addEventListener("change", () => {
  for (const place of document.querySelectorAll(".plot")) if (place.drawn) draw(place);
});

for (const figure of document.querySelectorAll(".compare")) {
  const [under, over] = figure.querySelectorAll("img");
  figure.querySelector("input").addEventListener("input", (event) => {
    over.style.clipPath = `inset(0 0 0 ${event.target.value}%)`;
  });
  for (const select of figure.querySelectorAll("select")) {
    const [image, side] = select.dataset.side === "left" ? [under, "left"] : [over, "right"];
    select.addEventListener("change", () => {
      image.src = select.value;
      image.alt = `${side} side: ${select.selectedOptions[0].textContent}`;
    });
  }
}

for (const pairs of document.querySelectorAll(".pairs")) {
  const all = pairs.querySelectorAll(".pair");
  pairs.querySelector("select").addEventListener("change", (event) => {
    all.forEach((pair, place) => (pair.hidden = place !== event.target.selectedIndex));
  });
}

for (const button of document.querySelectorAll(".show-map")) {
  button.addEventListener("click", () => {
    const frame = document.createElement("iframe");
    frame.title = "Map in 3D";
    frame.src = button.dataset.src;
    button.closest("section").append(frame);
    button.remove();
  });
}

const beside = document.getElementById("beside-data");
if (beside) {
  const views = JSON.parse(beside.textContent);
  const [view, what, cards] = ["beside-view", "beside-what", "beside-cards"].map((id) => document.getElementById(id));
  const card = (source, caption) => {
    const [figure, text] = [document.createElement("figure"), document.createElement("figcaption")];
    text.textContent = caption;
    if (source) {
      const image = document.createElement("img");
      Object.assign(image, { loading: "lazy", src: source, alt: caption });
      figure.append(image);
    }
    figure.append(text);
    return figure;
  };
  const show = () => {
    const runs = views[view.value];
    const truth = runs.find((run) => run.files.truth);
    const made = truth && what.value === "render" ? [card(truth.files.truth, "ground truth")] : [];
    for (const run of runs) {
      const file = run.files[what.value];
      const said = [run.run, run.psnr ?? "not scored", run.seen, ...(file ? [] : ["no such picture"])];
      made.push(card(file, said.join(", ")));
    }
    cards.replaceChildren(...made);
  };
  for (const select of [view, what]) select.addEventListener("change", show);
  show();
}
