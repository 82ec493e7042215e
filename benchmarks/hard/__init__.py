"""The cases of hard_cases.py: one function each, in files by what they strain."""
