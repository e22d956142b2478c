"""How far the robot has turned, and moved, by sight (thesis, chapter 4, and beyond it)."""
