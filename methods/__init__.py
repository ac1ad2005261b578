"""The methods, each in a file of its own; `methods.base` holds their one interface."""
