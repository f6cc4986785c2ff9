"""The layout for Foxglove and Lichtblick: ``template.json``, with the panels that have something to show in a log.

The template is a layout as the viewers export it, for the topics and columns of the contract. To change the layout,
import the template in a viewer, edit it and export it. The ``.ts`` files are the scripts that make its tables.
"""
