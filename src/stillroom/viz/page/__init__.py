"""Pages to look at in a browser: one file each, with everything in it, and plots that can be zoomed."""
