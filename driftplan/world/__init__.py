"""Geometry: maps and files. No OMPL, no beacons.

world, inflation, shapes    World: where a disc-shaped robot can drive, what it can see
box_world                   BoxWorld: where a ball-shaped one can fly among boxes
zones, zone_files           floors with odometry of their own, quick to find among many
formats, plain_data         what a name tells of a file; places as files know them; YAML and JSON from anybody, checked
mapfiles                    load_world, save_world; formats: ros_map, movingai_map, geojson_map, imdf_map, building_map,
                            dxf_map
cells                       from cells to polygons and back
route_graphs                nodes and edges of nav2, of fleets and of buildings, there and back
route_files                 routes, recorded or drawn, and as ROS has them: paths, poses, waypoints
odometry_logs, log_tables   recordings: TUM, KITTI, MR.CLAM, CSV, MATLAB
log_formats, log_checks     and ROS bags, CARMEN, g2o; are rows and columns what they are taken for
noise_files                 a noise as YAML; what it means for messages of ROS
"""
