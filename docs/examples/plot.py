"""A plot: both boundaries and the truth over time, as a page."""

import plotly.graph_objects as go

import roadperc_stream as rp

rp.replay("logs/sample.mcap", "plot.mcap", force=True)
frames = rp.read_metrics("plot.mcap")
seconds = (frames["stamp_ns"] - frames["stamp_ns"][0]) / 1e9
figure = go.Figure(layout={"xaxis_title": "s", "yaxis_title": "m to the left", "title": "Ego lane"})
for side in ("left", "right"):
    for kind in ("", "raw_", "true_"):
        column = f"lane_{side}_{kind}offset_m"
        figure.add_scatter(x=seconds, y=frames[column], name=column, line={"dash": "dot" if kind else "solid"})
figure.write_html("lanes.html")
print("lanes.html")
