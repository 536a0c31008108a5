"""The words, figures and page of a diagnosis."""
