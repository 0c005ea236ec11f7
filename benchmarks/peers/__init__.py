"""Other ways from one image and a rough axis to an outline or a solid."""
