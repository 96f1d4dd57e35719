"""The presets: one method a file, a row of the table in docs/how-it-works.md each."""
