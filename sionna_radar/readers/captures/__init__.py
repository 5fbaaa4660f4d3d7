"""Raw captures of the DCA1000 card, and their chirp configurations."""
