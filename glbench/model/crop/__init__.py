"""The tomato crop: photosynthesis, allocation, respiration and harvest of carbohydrates.

Source: Vanthoor (2011) chapter 9 and its appendix, as corrected in Katzin (2020, 2021).
"""
