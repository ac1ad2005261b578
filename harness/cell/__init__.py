"""One unit of work: what a cell is shown and compared with."""
