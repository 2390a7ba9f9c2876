"""Report of a run as one HTML file, and its tables, which the terminal prints too."""

from viz.report.report import Results, write_report
from viz.report.tables import METRICS, Metric, Table, hidden_table, metric_table, quantile_table
from viz.report.terminal import rich_table

__all__ = [
    "METRICS",
    "Metric",
    "Results",
    "Table",
    "hidden_table",
    "metric_table",
    "quantile_table",
    "rich_table",
    "write_report",
]
