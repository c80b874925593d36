// A zoom in time in one figure is one in all of them: their time axes are one per figure.
const overTime = [...document.querySelectorAll(".js-plotly-plot")].filter(
  (figure) => figure.layout.xaxis !== undefined,
);
let following = false;

function timeRange(change) {
  const axis = Object.keys(change).find((key) => /^xaxis\d*\.(range|autorange)/.test(key));
  if (axis === undefined) {
    return undefined;
  }
  const name = axis.split(".")[0];
  return change[name + ".autorange"]
    ? { "xaxis.autorange": true }
    : {
        "xaxis.range": change[name + ".range"] ?? [
          change[name + ".range[0]"],
          change[name + ".range[1]"],
        ],
      };
}

for (const figure of overTime) {
  figure.on("plotly_relayout", async (change) => {
    const range = following ? undefined : timeRange(change);
    if (range === undefined) {
      return;
    }
    following = true;
    try {
      await Promise.all(
        overTime.filter((other) => other !== figure).map((other) => Plotly.relayout(other, range)),
      );
    } finally {
      following = false;
    }
  });
}
