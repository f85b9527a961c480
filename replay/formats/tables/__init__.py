"""Tables of numbers, whatever stores them: text, arrays or the messages of a log."""
