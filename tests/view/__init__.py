"""The page in the browser and the pictures that it draws."""
