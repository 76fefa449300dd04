//! What a store tells about each source.

use crate::build::sources::{Source, Sources};
use crate::input::{Block, ForeignScan, Pose, Scan};
use crate::store::{AppendixPart, CrsInfo, DroppedPoints, PoseInfo, SkippedItems, SourceInfo};

/// What is to stand in the metadata and the appendix about the sources.
#[derive(Debug, Default)]
pub struct Described {
    /// One per file, or per scan in files of several.
    pub infos: Vec<SourceInfo>,
    /// Headers and records of the files, in the order of `infos`.
    pub appendix: Vec<AppendixPart>,
    /// The first reference system that a file tells.
    pub crs: CrsInfo,
    /// Points of all sources that are not in the store.
    pub dropped_points: u64,
}

impl Sources {
    /// Describes all sources; `points_of_file` is what was read of each file.
    pub fn describe(&self, points_of_file: &[u64]) -> Described {
        let mut described = Described::default();
        for (source, &points) in self.scans().iter().zip(points_of_file) {
            if let Some(stored) = &source.stored {
                described.infos.extend(stored.infos.iter().cloned());
                described.appendix.push(stored.appendix_part(source.path().into()));
                continue;
            }
            match &source.scan {
                Scan::Las(_) => describe_las(source, points, &mut described),
                Scan::Foreign(scan) => describe_foreign(source, scan, &mut described),
            }
        }
        if let Some(sample) = &self.sample {
            self.tell_sample(sample, &mut described.infos);
        }
        let dropped = described.infos.iter().flat_map(|info| &info.dropped);
        described.dropped_points = dropped.map(|dropped| dropped.points).sum();
        let told = self.scans().iter().map(|source| source.scan.crs());
        let crs = told.into_iter().find(|crs| crs.epsg.is_some() || crs.wkt.is_some());
        described.crs =
            crs.map_or(CrsInfo::default(), |crs| CrsInfo { epsg: crs.epsg, wkt: crs.wkt.clone() });
        described
    }

    /// Counts what a sample takes of files outside the LAS family; what was left out of it was not
    /// dropped.
    fn tell_sample(&self, sample: &[(usize, Block)], infos: &mut [SourceInfo]) {
        for info in infos.iter_mut().filter(|info| info.point_format.is_none()) {
            (info.points, info.dropped) = (0, Vec::new());
        }
        for (file, block) in sample {
            let source = &self.scans()[*file];
            let at = source.first_source as usize + source.scan.part_of(block);
            if source.scan.las().is_none()
                && let Some(info) = infos.get_mut(at)
            {
                info.points += block.expected_points();
            }
        }
    }
}

/// What is the same for all formats.
fn common(source: &Source, points: u64) -> SourceInfo {
    let name = source.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
    let warnings = source.scan.warnings().iter().chain(&source.warnings).cloned().collect();
    SourceInfo {
        name,
        format: source.scan.format(),
        points,
        warnings,
        attributes: source.own_attributes.clone(),
        ..SourceInfo::default()
    }
}

/// Reasons that are told one by one.
const MOST_REASONS: usize = 20;

/// Points that could not be read, each kind with its reason.
fn unread_as_dropped<'a>(unread: impl Iterator<Item = (&'a str, u64)>) -> Vec<DroppedPoints> {
    let mut dropped: Vec<DroppedPoints> = Vec::new();
    for (reason, points) in unread {
        let reason = format!("could not be read: {reason}");
        if dropped.len() == MOST_REASONS {
            let rest = dropped.last_mut().expect("there are several");
            rest.reason = "could not be read, for further reasons".into();
            rest.points += points;
        } else {
            dropped.push(DroppedPoints { reason, points });
        }
    }
    dropped
}

fn describe_las(source: &Source, kept: u64, described: &mut Described) {
    let Some(scan) = source.scan.las() else { return };
    let template = scan.template();
    let unread = &scan.facts().unread;
    let mut dropped =
        unread_as_dropped(unread.iter().map(|unread| (unread.reason.as_str(), unread.points)));
    if let Some(fault) = source.fault() {
        let lost = scan.points().saturating_sub(kept);
        dropped.extend(unread_as_dropped([(fault.as_str(), lost)].into_iter()));
    }
    let points = kept + dropped.iter().map(|dropped| dropped.points).sum::<u64>();
    described.infos.push(SourceInfo {
        dropped,
        point_format: Some(scan.facts().point_format),
        header_bytes: template.header_bytes().len() as u64,
        vlr_bytes: template.vlr_bytes().len() as u64,
        evlr_bytes: template.evlrs().iter().map(|range| range.end - range.start).sum(),
        ..common(source, points)
    });
    described.appendix.push(AppendixPart::Bytes(template.header_bytes().to_vec()));
    described.appendix.push(AppendixPart::Bytes(template.vlr_bytes().to_vec()));
    for range in template.evlrs() {
        let (offset, bytes) = (range.start, range.end - range.start);
        described.appendix.push(AppendixPart::FileRange {
            path: source.path().into(),
            offset,
            bytes,
        });
    }
}

fn describe_foreign(source: &Source, scan: &ForeignScan, described: &mut Described) {
    let facts = scan.facts();
    let mut kept = vec![0u64; facts.parts.len()];
    for block in &facts.blocks {
        kept[block.part as usize] += block.points;
    }
    for (index, part) in facts.parts.iter().enumerate() {
        let mut info = common(source, part.points);
        let unread = facts.unread.iter().filter(|unread| unread.part as usize == index);
        let lost: u64 = unread.clone().map(|unread| unread.points).sum();
        let dropped = part.points - (kept[index] + lost).min(part.points);
        if dropped > 0 {
            let reason = "a coordinate is not finite or is marked invalid".to_string();
            info.dropped.push(DroppedPoints { reason, points: dropped });
        }
        info.dropped.extend(unread_as_dropped(unread.map(|u| (u.reason.as_str(), u.points))));
        info.scan = part.name.clone();
        info.scan_index = (facts.parts.len() > 1).then_some(index as u32);
        info.pose = part.pose.map(|pose| pose_info(pose, scan.applies_poses()));
        // What belongs to the file stands with its first scan only.
        if index == 0 {
            let skipped = facts.skipped.iter();
            info.skipped = skipped
                .map(|(what, count)| SkippedItems { what: what.clone(), count: *count })
                .collect();
        } else {
            info.warnings.clear();
        }
        described.infos.push(info);
    }
}

fn pose_info(pose: Pose, applied: bool) -> PoseInfo {
    let [x, y, z, w] = pose.rotation.to_array();
    PoseInfo { rotation: [w, x, y, z], translation: pose.translation.to_array(), applied }
}
