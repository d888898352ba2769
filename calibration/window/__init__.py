"""The sliding window of the CoP paper (Eq. 14), and Han's quasi-static method as a preset of it."""
