// Normals of depth frames the way of the Point Cloud Library: cloud, voxel grid, principal components of each voxel's neighbours.
//
//   voxel_normals FRAMES RESULT LEAF_M NEIGHBOURS REPEATS
//
// FRAMES: 8 bytes "tgdepth1"; uint32 frames, width, height; float fx, fy, cx, cy (pixels); then per frame width x height uint16
// millimetres. RESULT: per frame uint32 points; then per point six floats: x, y, z (m), normal towards the camera. Everything
// little-endian. One line per frame on standard output: the fastest and the median time, ms, of REPEATS runs from the frame in memory
// to the normals. LEAF_M 0 means no voxel grid: the full cloud.

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <vector>

#include <pcl/features/normal_3d.h>
#include <pcl/filters/voxel_grid.h>
#include <pcl/point_types.h>
#include <pcl/search/kdtree.h>

namespace {

struct Header {
    char magic[8];
    std::uint32_t frames, width, height;
    float fx, fy, cx, cy;
};

using Cloud = pcl::PointCloud<pcl::PointXYZ>;
using Normals = pcl::PointCloud<pcl::Normal>;

Cloud::Ptr cloud_of(const Header &h, const std::vector<std::uint16_t> &depth_mm) {
    Cloud::Ptr cloud(new Cloud);
    cloud->points.reserve(depth_mm.size());
    for (std::uint32_t v = 0; v < h.height; ++v) {
        for (std::uint32_t u = 0; u < h.width; ++u) {
            const float z = 0.001f * depth_mm[v * h.width + u];
            if (z > 0.0f) {
                cloud->points.emplace_back((u - h.cx) / h.fx * z, (v - h.cy) / h.fy * z, z);
            }
        }
    }
    cloud->width = cloud->points.size();
    cloud->height = 1;
    return cloud;
}

void run(const Header &h, const std::vector<std::uint16_t> &depth_mm, float leaf, int neighbours, Cloud::Ptr &points,
         Normals &normals) {
    Cloud::Ptr cloud = cloud_of(h, depth_mm);
    points = cloud;
    if (leaf > 0.0f) {
        points.reset(new Cloud);
        pcl::VoxelGrid<pcl::PointXYZ> grid;
        grid.setInputCloud(cloud);
        grid.setLeafSize(leaf, leaf, leaf);
        grid.filter(*points);
    }
    pcl::NormalEstimation<pcl::PointXYZ, pcl::Normal> estimation;
    estimation.setInputCloud(points);
    estimation.setSearchMethod(pcl::search::KdTree<pcl::PointXYZ>::Ptr(new pcl::search::KdTree<pcl::PointXYZ>));
    estimation.setKSearch(neighbours);
    estimation.setViewPoint(0.0f, 0.0f, 0.0f);
    estimation.compute(normals);
}

} // namespace

int main(int argc, char **argv) {
    if (argc != 6) {
        std::cerr << "usage: voxel_normals FRAMES RESULT LEAF_M NEIGHBOURS REPEATS\n";
        return 2;
    }
    std::ifstream in(argv[1], std::ios::binary);
    std::ofstream out(argv[2], std::ios::binary);
    const float leaf = std::strtof(argv[3], nullptr);
    const int neighbours = std::atoi(argv[4]);
    const int repeats = std::max(1, std::atoi(argv[5]));
    Header h{};
    if (!in.read(reinterpret_cast<char *>(&h), sizeof h) || std::memcmp(h.magic, "tgdepth1", 8) != 0) {
        std::cerr << argv[1] << ": not a file of depth frames\n";
        return 1;
    }
    std::vector<std::uint16_t> depth_mm(std::size_t(h.width) * h.height);
    for (std::uint32_t frame = 0; frame < h.frames; ++frame) {
        if (!in.read(reinterpret_cast<char *>(depth_mm.data()), depth_mm.size() * sizeof(std::uint16_t))) {
            std::cerr << argv[1] << ": ends within frame " << frame << "\n";
            return 1;
        }
        std::vector<double> times;
        Cloud::Ptr points;
        Normals normals;
        for (int i = 0; i < repeats; ++i) {
            const auto begin = std::chrono::steady_clock::now();
            run(h, depth_mm, leaf, neighbours, points, normals);
            times.push_back(std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count());
        }
        std::sort(times.begin(), times.end());
        std::cout << times.front() << " " << times[times.size() / 2] << "\n";
        const std::uint32_t count = points->points.size();
        out.write(reinterpret_cast<const char *>(&count), sizeof count);
        for (std::uint32_t i = 0; i < count; ++i) {
            const auto &p = points->points[i];
            const auto &n = normals.points[i];
            const float row[6] = {p.x, p.y, p.z, n.normal_x, n.normal_y, n.normal_z};
            out.write(reinterpret_cast<const char *>(row), sizeof row);
        }
    }
    return out.flush() ? 0 : 1;
}
