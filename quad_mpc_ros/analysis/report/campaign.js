const byId = (id) => document.getElementById(id);
const chosen = (id) => byId(id).value;
const ticked = (id) => byId(id).checked;

function command(parts, flight) {
  return parts.before + String(flight).padStart(parts.digits, "0") + parts.after;
}

// Names have places on an axis, 0, 1, ...; points of the same name are spread beside each other.
function placesOf(columns) {
  const values = columns.flat();
  if (!values.some((value) => typeof value === "string")) {
    return undefined;
  }
  return [...new Set(values.filter((value) => value !== null && value !== ""))].sort();
}

function placed(values, places) {
  if (places === undefined) {
    return values;
  }
  const spread = (row) => 0.5 * ((row * 0.6180339887) % 1) - 0.25;
  return values.map((value, row) =>
    value === null || value === "" ? null : places.indexOf(value) + spread(row),
  );
}

function axisOf(title, places, logarithmic) {
  const axis = { title: { text: escaped(title) } };
  if (places === undefined) {
    return { ...axis, type: logarithmic ? "log" : "linear", exponentformat: "power" };
  }
  return { ...axis, tickvals: places.map((_, place) => place), ticktext: places.map(escaped) };
}

// Plotly reads some HTML in its texts.
function escaped(text) {
  return String(text).replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll(">", "&gt;");
}

// Return a trace for each group of flights that has any.
function pointTraces(set, x, y, shown) {
  return set.groups.flatMap((group, number) => {
    const there = (row) => x[row] !== null && y[row] !== null;
    const rows = set.group.flatMap((of, row) => (of === number && there(row) ? [row] : []));
    if (rows.length === 0) {
      return [];
    }
    return [
      {
        type: "scatter",
        mode: "markers",
        name: escaped(group.name),
        x: rows.map((row) => x[row]),
        y: rows.map((row) => y[row]),
        customdata: rows.map((row) => [set.flight[row], shown.x[row], shown.y[row]]),
        meta: set.commands,
        marker: {
          color: group.colour,
          symbol: group.symbol,
          size: group.size,
          opacity: group.opacity,
        },
        hovertemplate:
          "flight %{customdata[0]}<br>%{customdata[1]}, %{customdata[2]}" +
          `<extra>${escaped(group.name)}</extra>`,
      },
    ];
  });
}

function draw(key, traces, layout) {
  const figure = byId(`figure-${key}`);
  byId(`${key}-again`).textContent = "";
  Plotly.react(figure, traces, { ...data.layout, ...layout }, data.config[key]);
  if (figure.dataset.listens === undefined) {
    figure.dataset.listens = "clicks";
    figure.on("plotly_click", (event) => {
      const point = event.points[0];
      if (point.data.meta !== undefined) {
        byId(`${key}-again`).textContent = point.data.meta
          .map((parts) => command(parts, point.customdata[0]))
          .join("\n");
      }
    });
  }
}

// More crashes are drawn than there are among all flights where not all flights are.
function howMany(sets) {
  const drawn = sets.reduce((sum, set) => sum + set.flight.length, 0);
  const total = sets.reduce((sum, set) => sum + set.total, 0);
  return drawn < total
    ? `${drawn} of ${total} flights are drawn: those that crashed before others, the rest evenly ` +
        "chosen. Shares and distributions are of all."
    : "";
}

// Points that have no place on a logarithmic axis are not drawn, and that is said.
function notDrawn(columns) {
  const count = columns.filter((value) => typeof value === "number" && value <= 0).length;
  return count > 0 ? `Of ${count} values of 0 or less a logarithmic axis shows nothing.` : "";
}

function drawPoints(key, sets, names, logarithmic) {
  const column = (set, name) => set.columns[name] ?? set.flight.map(() => null);
  const places = { x: undefined, y: undefined };
  const notes = [howMany(sets)];
  for (const axis of ["x", "y"]) {
    places[axis] = placesOf(sets.map((set) => column(set, names[axis])));
    if (logarithmic[axis] && places[axis] === undefined) {
      notes.push(notDrawn(sets.flatMap((set) => column(set, names[axis]))));
    }
  }
  const traces = sets.flatMap((set) => {
    const shown = { x: column(set, names.x), y: column(set, names.y) };
    return pointTraces(set, placed(shown.x, places.x), placed(shown.y, places.y), shown);
  });
  byId(`${key}-notes`).textContent = notes.filter(Boolean).join(" ");
  draw(key, traces, {
    xaxis: axisOf(names.x, places.x, logarithmic.x),
    yaxis: axisOf(names.y, places.y, logarithmic.y),
  });
}

function drawMap() {
  const sets = data.pairs === null ? data.flights : [data.pairs];
  drawPoints("map", sets, { x: chosen("map-x"), y: chosen("map-y") }, { x: false, y: false });
}

function drawScatter() {
  drawPoints(
    "scatter",
    data.flights,
    { x: chosen("scatter-x"), y: chosen("scatter-y") },
    { x: ticked("scatter-log-x"), y: ticked("scatter-log-y") },
  );
}

function drawPairs() {
  const name = chosen("pair-figure");
  const { first, second, summary } = data.pairs.figures[name];
  const logarithmic = ticked("pair-log");
  const known = first.flatMap((value, row) =>
    value === null || second[row] === null || data.pairs.group[row] !== 0
      ? []
      : [value, second[row]],
  );
  const drawable = known.filter((value) => !logarithmic || value > 0);
  const ends = drawable.reduce(
    ([least, greatest], value) => [Math.min(least, value), Math.max(greatest, value)],
    [Infinity, -Infinity],
  );
  const line = {
    type: "scatter",
    mode: "lines",
    x: ends,
    y: ends,
    line: { color: "#333333", width: 1, dash: "dash" },
    hoverinfo: "skip",
    showlegend: false,
  };
  // Of a vehicle that crashed in one of them the figures cannot be compared.
  const unharmed = { ...data.pairs, groups: data.pairs.groups.slice(0, 1) };
  const points = pointTraces(unharmed, second, first, { x: second, y: first });
  byId("pair-notes").textContent = [
    summary,
    howMany([data.pairs]),
    logarithmic ? notDrawn(known) : "",
  ]
    .filter(Boolean)
    .join(" ");
  draw("pair", drawable.length > 0 ? [line, ...points] : points, {
    showlegend: false,
    xaxis: {
      ...axisOf(`${name}, ${data.names[1]}`, undefined, logarithmic),
      constrain: "domain",
    },
    yaxis: {
      ...axisOf(`${name}, ${data.names[0]}`, undefined, logarithmic),
      scaleanchor: "x",
      constrain: "domain",
    },
  });
}

function histogram(found, logarithmic) {
  // On a logarithmic axis Plotly places bars by the power of ten.
  const edges = logarithmic ? found.edges.map(Math.log10) : found.edges;
  return data.names.map((name, number) => ({
    type: "bar",
    name: escaped(name),
    x: found.edges.slice(1).map((_, bin) => 0.5 * (edges[bin] + edges[bin + 1])),
    width: edges.slice(1).map((edge, bin) => edge - edges[bin]),
    y: found.counts[number],
    customdata: found.counts[number].map((_, bin) => [found.edges[bin], found.edges[bin + 1]]),
    marker: { color: data.colours[number], line: { width: 1, color: "white" } },
    opacity: data.names.length > 1 ? 0.55 : 0.9,
    hovertemplate:
      "%{customdata[0]:.4g} to %{customdata[1]:.4g}: %{y} flights" +
      `<extra>${escaped(name)}</extra>`,
  }));
}

function cumulative(found) {
  return found.map(({ x, y }, number) => ({
    type: "scatter",
    mode: "lines",
    name: escaped(data.names[number]),
    x,
    y,
    line: { color: data.colours[number], shape: "hv", width: 2 },
    hovertemplate: `%{y:.1%} have at most %{x:.4g}<extra>${escaped(data.names[number])}</extra>`,
  }));
}

// Whole powers of ten, and 2 and 5 of them where there are few.
function powerTicks(edges) {
  const [first, last] = [Math.log10(edges[0]), Math.log10(edges.at(-1))];
  const parts = last - first < 4 ? [1, 2, 5] : [1];
  const values = [];
  for (let power = Math.floor(first); power <= Math.ceil(last); power += 1) {
    values.push(...parts.map((part) => part * 10 ** power));
  }
  return { tickvals: values.map(Math.log10), ticktext: values.map((v) => v.toPrecision(1) * 1) };
}

function drawDistribution() {
  const name = chosen("distribution-figure");
  const logarithmic = ticked("distribution-log");
  const found = data.distributions[name][chosen("distribution-of")];
  const asHistogram = chosen("distribution-as") === "histogram";
  const bins = logarithmic ? found.log : found.linear;
  const axis = { title: { text: escaped(name) }, exponentformat: "power" };
  const empty = bins === null;
  byId("distribution-notes").textContent = empty
    ? `No flight has a value${logarithmic ? " above 0" : ""}.`
    : "";
  if (!asHistogram) {
    draw("distribution", cumulative(found.cumulative), {
      xaxis: { ...axis, type: logarithmic ? "log" : "linear" },
      yaxis: { title: { text: "share of flights" }, tickformat: ".0%", range: [0, 1.02] },
    });
    return;
  }
  draw("distribution", empty ? [] : histogram(bins, logarithmic), {
    barmode: "overlay",
    bargap: 0,
    xaxis: logarithmic && !empty ? { ...axis, ...powerTicks(bins.edges) } : axis,
    yaxis: { title: { text: "flights" } },
  });
}

function row(kind, texts) {
  const line = document.createElement("tr");
  for (const text of texts) {
    const cell = document.createElement(kind);
    cell.textContent = text;
    line.append(cell);
  }
  return line;
}

function shown(value, digits) {
  return value === null ? "–" : String(Number(value.toPrecision(digits)));
}

function showWorst() {
  const figure = chosen("worst-by");
  const table = document.createElement("table");
  const several = data.names.length > 1;
  const campaign = several ? ["campaign"] : [];
  table.append(row("th", [...campaign, "flight", "crash", "at [s]", figure, "again"]));
  data.names.forEach((name, number) => {
    for (const [flight, crash, time, value] of data.worst[number][figure]) {
      const texts = [flight, crash && (data.crashes[crash] ?? crash), crash && shown(time, 4)];
      const again = command(data.flights[number].commands[0], flight);
      table.append(row("td", [...(several ? [name] : []), ...texts, shown(value, 4), again]));
    }
  });
  byId("worst-table").replaceChildren(table);
}

for (const [key, show] of Object.entries({
  map: drawMap,
  pair: drawPairs,
  distribution: drawDistribution,
  scatter: drawScatter,
  worst: showWorst,
})) {
  const controls = document.querySelectorAll(`select[id^="${key}-"], input[id^="${key}-"]`);
  for (const control of controls) {
    control.addEventListener("change", show);
  }
  if (controls.length > 0) {
    show();
  }
}
