"""Pictures of dense clouds, drawn without a display."""
