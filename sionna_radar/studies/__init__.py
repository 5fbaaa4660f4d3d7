"""Studies made of surveys; each returns a result, and writes nothing."""
