"""Where cells are computed: cells in, results out."""
