"""Report of a run as one HTML file, and its tables, which the terminal prints too."""
