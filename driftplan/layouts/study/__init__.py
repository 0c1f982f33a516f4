"""Studies: a scenario of which some things are varied, a cell for every combination. Imports go down this list:

run                             run_study: what is not done yet; StudyResult, and the file of its rows
answers                         curves, knees, which parameter matters most
executors, cluster              in this process, in others, on a Dask cluster
work                            what is done for a cell, by a process of its own too
inputs                          what a study names, read and told apart by content
study                           the study file and its cells; what it may say
"""
