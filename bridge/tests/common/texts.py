"""Texts of any size whose content shows whether they are complete, as `texts.rs` makes them."""

ALPHABET = "abcdefghijklmnopqrstuvwxyz"


def text_of(number, size):
    """A text whose message std_msgs/msg/String has `size` bytes on the wire, without the encapsulation."""
    length = size - 5  # the length before it, the zero after it
    head = f"{number}:"
    return (head + ALPHABET * (length // len(ALPHABET) + 1))[:length]


def number_of(text):
    """The number of a text, and its size; nothing if it is not as it was made."""
    number, size = text.split(":", 1)[0], len(text) + 5
    return [int(number), size] if number.isdigit() and text == text_of(int(number), size) else None
