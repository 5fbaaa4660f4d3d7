"""Parts of self-contained web pages: their document, the numbers packed inside, the world in three dimensions."""
