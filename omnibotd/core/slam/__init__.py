"""Robot and landmarks from bearings alone (thesis, chapter 5): filters, and a smoother as reference."""
