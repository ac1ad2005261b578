"""Pages and figures of rows."""
