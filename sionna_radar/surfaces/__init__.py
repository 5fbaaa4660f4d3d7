"""What a surface does to a wave: permittivity, rough-surface models, measured tables."""
