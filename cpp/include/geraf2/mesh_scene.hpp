// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "geraf2/types.hpp"

namespace geraf2 {

/// Crossings of many rays with a surface, packed ray after ray and sorted along each ray.
struct Crossings {
    std::vector<index_t> offsets;       ///< (n_rays + 1): crossings of ray r are [r], [r + 1)
    std::vector<double> distances;      ///< along the unit direction [m]
    std::vector<std::uint8_t> entering; ///< 1 where the ray goes in through an outward-wound face
};

/// Triangle mesh under a bounding volume hierarchy; the only user of Embree.
/// Queries are const and may run from several threads at once.
class MeshScene {
public:
    MeshScene(std::span<const double> vertices, // (n_vertices, 3) [m]
              std::span<const index_t> faces);  // (n_faces, 3), indices checked by the caller
    ~MeshScene();
    MeshScene(MeshScene&&) noexcept;
    MeshScene& operator=(MeshScene&&) noexcept;
    MeshScene(const MeshScene&) = delete;
    MeshScene& operator=(const MeshScene&) = delete;

    /// First face along each ray; distance +inf and face -1 where the ray misses.
    void closest_hit(std::span<const double> origins,    // (n_rays, 3) [m]
                     std::span<const double> directions, // (n_rays, 3), any length but zero
                     std::span<double> distances,        // (n_rays) [m]
                     std::span<index_t> hit_faces,       // (n_rays)
                     int num_threads) const;

    /// Where the segment from origin to target first meets a face; the target where it meets none.
    void first_meetings(std::span<const double> origins, // (n, 3) [m]
                        std::span<const double> targets, // (n, 3) [m]
                        std::span<double> places,        // (n, 3) [m]
                        int num_threads) const;

    /// Where each ray first goes into the mesh, 0 if it starts inside, +inf if never, and where it
    /// last leaves it, -inf if never.
    void spans(std::span<const double> origins,    // (n_rays, 3) [m]
               std::span<const double> directions, // (n_rays, 3)
               bool wound_outward,                 // how the faces are wound
               std::span<double> near,             // (n_rays) [m]
               std::span<double> far,              // (n_rays) [m]
               int num_threads) const;

    /// 1 where the open segment, shortened by margin_m at both ends, meets a face.
    void occluded(std::span<const double> origins, // (n_segments, 3) [m]
                  std::span<const double> targets, // (n_segments, 3) [m]
                  double margin_m,                 //
                  std::span<std::uint8_t> blocked, // (n_segments)
                  int num_threads) const;

    /// Every crossing at distance >= 0; one crossing where a ray meets an edge shared by two faces.
    [[nodiscard]] Crossings crossings(std::span<const double> origins,    // (n_rays, 3) [m]
                                      std::span<const double> directions, // (n_rays, 3)
                                      int num_threads) const;

    /// Distance to the nearest face. Quickest where points near each other follow each other.
    void distance(std::span<const double> points, // (n_points, 3) [m]
                  std::span<double> distances,    // (n_points) [m]
                  int num_threads) const;

    /// Distance to the nearest face, negative inside; sign as in `contains`, or that of the point
    /// before where no face can be in between.
    void signed_distance(std::span<const double> points, // (n_points, 3) [m]
                         std::span<double> distances,    // (n_points) [m]
                         int num_threads) const;

    /// 1 where most of five rays leave the mesh more often than they enter it.
    void contains(std::span<const double> points, // (n_points, 3) [m]
                  std::span<std::uint8_t> inside, // (n_points)
                  int num_threads) const;

    /// Generalised winding number: solid angle of all faces / 4 pi; O(n_points n_faces).
    void winding_number(std::span<const double> points, // (n_points, 3) [m]
                        std::span<double> winding,      // (n_points)
                        int num_threads) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

} // namespace geraf2
